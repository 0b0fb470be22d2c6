import pytest
from harness import Harness


@pytest.fixture
def ros_test(tmp_path):
    harness = Harness(tmp_path)
    yield harness
    harness.close()
