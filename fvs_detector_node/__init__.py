"""Images of an RGB-D camera in, position of the ball out."""
