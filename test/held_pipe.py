"""Pipes as a held terminal has them."""

import os


def full_pipe():
    """A pipe that holds all it can."""
    source, sink = os.pipe()
    os.set_blocking(sink, False)
    try:
        while True:
            os.write(sink, b"." * 4096)
    except BlockingIOError:
        os.set_blocking(sink, True)
    return source, sink
