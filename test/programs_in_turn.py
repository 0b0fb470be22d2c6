"""Runs programs one after the other, each in a process of its own that has imported all of them.

``python -m programs_in_turn``: a JSON list of modules and their arguments comes in, a list of exit
codes and what was printed goes out.
"""

import json
import os
import subprocess
import sys
from importlib import import_module


def run(programs, **how):
    """Exit code and output of each program, a module and its arguments."""
    done = subprocess.run(
        [sys.executable, "-m", "programs_in_turn"],
        input=json.dumps([[module, list(arguments)] for module, arguments in programs]),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        **how,
    )
    return json.loads(done.stdout.splitlines()[-1])


def _run(module, arguments):
    source, sink = os.pipe()
    child = os.fork()
    if not child:
        os.dup2(sink, 1)
        os.dup2(sink, 2)
        os.closerange(source, sink + 1)
        sys.argv = [module, *arguments]
        try:
            code = import_module(module).main()
        except SystemExit as end:
            code = end.code
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code or 0)
    os.close(sink)
    with open(source, "rb") as stream:
        text = stream.read().decode("utf-8", "replace")
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), text


if __name__ == "__main__":
    asked = json.load(sys.stdin)
    for name in {name for name, _ in asked}:
        import_module(name)
    print("\n" + json.dumps([_run(*program) for program in asked]))
