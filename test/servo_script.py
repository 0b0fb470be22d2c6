"""A user's script, which goes to a reference."""

from fvs_ros import ServoClient

with ServoClient() as servo:
    servo.go_to("grasp")
