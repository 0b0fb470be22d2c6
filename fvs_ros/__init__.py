"""Uncalibrated visual servoing of a robot arm: what the nodes share, and what composes them."""
