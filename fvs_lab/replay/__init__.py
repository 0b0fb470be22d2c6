"""What a recording shows, of simulation or of a real robot; needs no ROS."""
