"""Standard output and error that never wait, in processes of their own."""

import fcntl
import os
import pty
import subprocess
import sys

import pytest
from held_pipe import full_pipe

OPEN = """
import os, sys, time
from fvs_ros import console
"""
#: Far more than any pipe holds.
FLOOD = """
    began_s = time.monotonic()
    for _ in range(2000):
        try:
            os.write(1, b"x" * 1024)
        except BlockingIOError:
            pass
        print("y" * 1024)
        print("z" * 1024, file=sys.stderr)
    took_s = time.monotonic() - began_s
"""


def run(body, **streams):
    return subprocess.run(
        [sys.executable, "-c", OPEN + body],
        check=False,
        timeout=20,
        **(streams or {"capture_output": True, "text": True}),
    )


def test_what_is_said_arrives_in_order():
    done = run("""
with console.never_blocking():
    for number in range(3000):
        print(number)
        os.write(1, b"and\\n")
    print("no newline", end="")
    print("as usual", file=sys.stderr)
print(" after")
""")
    assert done.returncode == 0
    lines = [line for number in range(3000) for line in (str(number), "and")]
    assert done.stdout.splitlines() == [*lines, "no newline after"]
    assert done.stderr == "as usual\n"


def test_a_pipe_that_nobody_reads_holds_nobody(tmp_path):
    source, sink = full_pipe()
    told = tmp_path / "told"
    done = run(
        f"""
with console.never_blocking():{FLOOD}
    sys.stdout.write("w" * 1_000_000)
    open({str(told)!r}, "w").write(str(took_s))
print("the end is not held either")
raise SystemExit(3)
""",
        stdout=sink,
        stderr=sink,
    )
    os.close(source)
    os.close(sink)
    assert done.returncode == 3
    assert float(told.read_text()) < 1.0


@pytest.mark.parametrize("closed", ["by its reader", "from the start"])
def test_output_that_is_closed_is_no_error(tmp_path, closed):
    told = tmp_path / "told"
    body = f"with console.never_blocking():{FLOOD}\n    open({str(told)!r}, 'w').write('well')"
    pipe = "| true" if closed == "by its reader" else ">&- 2>&-"
    done = subprocess.run(
        ["sh", "-c", f'"$0" -c "$1" {pipe}', sys.executable, OPEN + body],
        stderr=subprocess.DEVNULL,
        check=False,
    )
    assert done.returncode == 0
    assert told.read_text() == "well"


def test_a_crash_is_still_told_and_the_descriptors_are_as_before():
    done = run("""
before = [os.fstat(fd).st_ino for fd in (1, 2)], sys.stdout, sys.stderr
open_before = len(os.listdir("/proc/self/fd"))
try:
    with console.never_blocking():
        assert os.fstat(1).st_ino != before[0][0]
        raise KeyError("inner")
except KeyError:
    pass
assert ([os.fstat(fd).st_ino for fd in (1, 2)], sys.stdout, sys.stderr) == before
assert len(os.listdir("/proc/self/fd")) == open_before
with console.never_blocking():
    raise KeyError("the crash")
""")
    assert done.returncode == 1
    assert done.stderr.endswith("KeyError: 'the crash'\n")
    assert "inner" not in done.stderr


@pytest.mark.parametrize("terminal", [True, False])
def test_a_terminal_stays_one_and_is_left_as_it_was(terminal):
    ours, theirs = pty.openpty() if terminal else os.pipe()
    flags = fcntl.fcntl(theirs, fcntl.F_GETFL)
    environment = {k: v for k, v in os.environ.items() if k != "RCUTILS_COLORIZED_OUTPUT"}
    done = run(
        """
began_s = time.monotonic()
with console.never_blocking():
    assert not os.isatty(2)
    print(sys.stderr.isatty(), os.environ.get("RCUTILS_COLORIZED_OUTPUT"), file=sys.stderr)
    assert not sys.stdout.isatty()
assert time.monotonic() - began_s < 0.3
""",
        stdout=subprocess.DEVNULL,
        stderr=theirs,
        env=environment,
    )
    assert os.read(ours, 4096).split() == ([b"True", b"1"] if terminal else [b"False", b"None"])
    assert fcntl.fcntl(theirs, fcntl.F_GETFL) == flags
    os.close(ours)
    os.close(theirs)
    assert done.returncode == 0


# --- readers that leave ---

TELLS = """
@console.reader_may_leave()
def main():
    for number in range(30_000):
        print("line", number)
    print("and to the error", file=sys.stderr)
    open(sys.argv[1], "w").write("well")
main()
"""


def test_a_program_whose_reader_has_enough_ends_as_it_would(tmp_path):
    command = [sys.executable, "-c", OPEN + TELLS, str(tmp_path / "told")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout.readline() == b"line 0\n"
    process.stdout.close()
    assert process.stderr.read() == b"and to the error\n"
    assert process.wait(20) == 0
    assert (tmp_path / "told").read_text() == "well"


@pytest.mark.parametrize("program", ["fvs_lab.main", "fvs_tools.launcher", "fvs_tools.train"])
def test_every_program_may_be_piped_into_one_that_leaves(program):
    source, sink = os.pipe()
    os.close(source)
    done = subprocess.run(
        [sys.executable, "-m", program, "--help"],
        env={name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"},
        stdout=sink,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        timeout=60,
    )
    os.close(sink)
    assert (done.returncode, done.stderr) == (0, "")
