"""Files from strangers: used, or refused in words; nothing else."""

from hypothesis import HealthCheck, settings

FEW = settings(
    max_examples=60,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def unless_refused(load, path, content):
    """Load a file of this content; None if it is refused, in words that name the file."""
    path.write_bytes(content)
    try:
        return load(path)
    except ValueError as refusal:
        words = str(refusal)
    assert path.name in words
    assert len(words) < 5000
    return None
