"""A stable of programs that are warm: one process that has imported everything, and forks.

Starting `traction-gateway` costs seconds of imports in user-mode-linux; two hundred starts would be
half an hour of nothing else. A child runs the same `main` with the same words as a user's command;
only the imports and the loading of compiled code have been done before. It is killed and ends like
any other process.

`python tests/hil/stable.py` reads a line of JSON per request from its input and answers
each with a line:
`{"start": [words], "log": path, "priority": n, "trap": path}` -> pid;
`{"wait": pid, "block": bool}` -> how it ended (exit code or minus the signal), null if not yet.

A gateway stops itself (SIGSTOP) between deciding and sending as soon as the file `trap` is there,
which it takes away: a signal from outside would hardly ever come just there.
"""

import json
import os
import signal
import subprocess
import sys
import traceback


class Stable:
    """The asking end."""

    def __init__(self):
        """Open it; takes seconds."""
        pipe = subprocess.PIPE
        self._process = subprocess.Popen([sys.executable, __file__], stdin=pipe, stdout=pipe)
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == b'"warm"\n'

    def close(self):
        """End it; its programs are the caller's to end."""
        self._process.communicate(timeout=20)

    def start(self, words, log, priority=0, trap=None):
        """Fork a program; its outputs go to `log`. Returns its pid."""
        request = {"start": list(words), "log": str(log), "priority": priority}
        return int(self._ask(**request, trap=str(trap or "")))

    def ended(self, pid, *, block=False):
        """How a program ended: exit code, or minus the signal; None while it runs."""
        answer = self._ask(wait=pid, block=block)
        return None if answer is None else int(answer)

    def _ask(self, **request):
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(request).encode() + b"\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        assert answer, "the stable has gone"
        return json.loads(answer)


def _child(request):
    """What a fork does instead of going on; never returns."""
    code = 70
    try:
        descriptor = os.open(request["log"], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        for standard in (1, 2):
            os.dup2(descriptor, standard)
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        if request["priority"]:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(request["priority"]))
        from gateway.cli import main

        if request["trap"]:
            _set_trap(request["trap"])
        code = main(request["start"])
    except SystemExit as ending:
        code = int(ending.code or 0)
    except BaseException:  # told in the log, whatever it was
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _set_trap(path):
    """See above. Nothing but the moment of the stop is different."""
    from gateway.core.gateway import Gateway

    step = Gateway.step

    def trapped(self, *given):
        decided = step(self, *given)
        if os.path.exists(path):  # noqa: PTH110 - in every tick
            os.unlink(path)  # noqa: PTH108
            os.kill(os.getpid(), signal.SIGSTOP)
        return decided

    Gateway.step = trapped


def _warm():
    """Import what `run` and `sim` import and make what they make, by the commands themselves."""
    import can.interfaces.socketcan  # noqa: F401

    from dbc.codec import bind
    from gateway.cli import main
    from gateway.commands import run, sim  # noqa: F401
    from gateway.core.gateway import Gateway
    from gateway.io import (
        scheduling,  # noqa: F401
    )
    from gateway.settings.config import load

    config = load(None)
    Gateway(config, bind(config.dbc_path, config.nodes), 0)
    words = ("sim", "healthy", "--duration", "0.05", "-o", os.devnull)
    assert main(words) == 0


def _serve():
    answers = os.fdopen(os.dup(1), "w", encoding="ascii")
    os.dup2(2, 1)  # nothing that a library prints is an answer

    def say(answer):
        answers.write(json.dumps(answer) + "\n")
        answers.flush()

    say("warm")
    for line in sys.stdin:
        request = json.loads(line)
        if "start" in request:
            pid = os.fork()
            if pid == 0:
                _child(request)
            say(pid)
        else:
            found, status = os.waitpid(request["wait"], 0 if request["block"] else os.WNOHANG)
            say(os.waitstatus_to_exitcode(status) if found else None)


if __name__ == "__main__":
    _warm()
    _serve()
