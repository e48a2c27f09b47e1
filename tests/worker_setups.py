"""What the pool's tests run in worker processes: importable there, as a worker imports it anew."""

import contextlib
import ctypes
import os
import threading
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from guidefield.deadline import Deadline
from guidefield.errors import RobotInvalid
from guidefield.messages.codec import Encoding
from guidefield.messages.replies import make_error_reply
from guidefield.pool.process import Call, Taken, Work
from guidefield.stream_worker import Open, Publication, RefusedOpening, Update

LONG = 300.0  # longer than any test waits for a worker [s]


def obedient() -> Work:
    """A worker that does what its jobs say."""
    return _obey


def broken() -> Work:
    """A worker that cannot be prepared."""
    raise ValueError("this worker cannot be prepared")


def _obey(job: tuple[str, str], call: Call) -> tuple[bool, bytes] | None:
    verb, value = job
    if verb in _TALKATIVE:
        return _TALKATIVE[verb](value, call)
    return _VERBS[verb](value)


def _echo(value: str) -> tuple[bool, bytes]:
    return True, value.encode()


def _pid(_value: str) -> tuple[bool, bytes]:
    return True, str(os.getpid()).encode()


def _sleep(value: str) -> tuple[bool, bytes]:
    time.sleep(float(value))
    return True, b"slept"


def _mark_and_sleep(value: str) -> tuple[bool, bytes]:
    Path(value).write_text(str(os.getpid()))
    time.sleep(LONG)
    return True, b"slept"


def _stuck_in_a_native_call(value: str) -> tuple[bool, bytes]:
    Path(value).write_text(str(os.getpid()))
    ctypes.PyDLL(None).sleep(int(LONG))  # keeps the interpreter's lock: no other thread of the process runs meanwhile
    return True, b"came back"


def _segfault(_value: str) -> tuple[bool, bytes]:
    ctypes.string_at(0)
    return True, b"unreachable"


def _refuse(value: str) -> tuple[bool, bytes]:
    return False, value.encode()


def _exit(value: str) -> tuple[bool, bytes]:
    os._exit(int(value))


def _grow(mebibytes: str) -> tuple[bool, bytes]:
    held = b"x" * (int(mebibytes) * 2**20)
    time.sleep(LONG)
    return True, str(len(held)).encode()


def _allocate(mebibytes: str) -> tuple[bool, bytes]:
    try:
        return True, str(len(bytearray(int(mebibytes) * 2**20))).encode()
    except MemoryError:
        return False, b"no memory"


def _until_cancelled(path: str, call: Call) -> tuple[bool, bytes]:
    Path(path).write_text(str(os.getpid()))
    deadline = time.monotonic() + LONG
    while not call.is_cancelled() and time.monotonic() < deadline:
        time.sleep(0.001)
    return True, b"cancelled" if call.is_cancelled() else b"outlasted"


def _last_word(files: str, call: Call) -> tuple[bool, bytes]:
    """Once it is to be ended early say so with a file, and answer when another one is there."""
    begun, told, heard = map(Path, files.split())
    _until_cancelled(str(begun), call)
    told.touch()
    _await_file(heard)
    return True, b"cancelled"


def _use(value: str, call: Call) -> tuple[bool, bytes]:
    """Once it is to be ended early use so much of a processor more [s]."""
    path, seconds = value.split()
    _until_cancelled(path, call)
    until = time.process_time() + float(seconds)
    while time.process_time() < until:
        pass
    return True, b"used it all"


def _give_way(path: str, call: Call) -> tuple[bool, bytes] | None:
    """The first time until it is to be ended early, the second time at once; the process writes a line each time."""
    begun = Path(path)
    again = begun.exists()
    with begun.open("a") as file:
        file.write(f"{os.getpid()}\n")
    if again:
        return True, b"begun anew"
    deadline = time.monotonic() + LONG
    while not call.is_cancelled() and time.monotonic() < deadline:
        time.sleep(0.001)
    return None if call.set_back() else (True, b"cancelled")


def _until_there(path: str) -> tuple[bool, bytes]:
    begun, awaited = path.split()
    Path(begun).write_text(str(os.getpid()))
    deadline = time.monotonic() + LONG
    while not Path(awaited).exists() and time.monotonic() < deadline:
        time.sleep(0.001)
    return True, b"came"


def _prepare(files: str, call: Call) -> tuple[bool, bytes]:
    """Prepare until a file is there, say so, and work until another one is."""
    begun, prepared, done = map(Path, files.split())
    begun.write_text(str(os.getpid()))
    _await_file(prepared)
    call.be_prepared()
    begun.with_suffix(".prepared").write_text(str(os.getpid()))
    _await_file(done)
    return True, b"done"


def _await_file(path: Path) -> None:
    deadline = time.monotonic() + LONG
    while not path.exists() and time.monotonic() < deadline:
        time.sleep(0.001)


def _tell(words: str, call: Call) -> tuple[bool, bytes]:
    for word in words.split():
        call.tell(word.encode())
    return True, b"told"


def _owe(value: str, call: Call) -> tuple[bool, bytes]:
    """Answer at once, and write a file once another one is there."""
    asked, written = map(Path, value.split())

    def pay() -> None:
        _await_file(asked)
        written.write_text("whole")

    call.defer_required(pay)
    return True, b"owed"


def _grow_after(mebibytes: str, call: Call) -> tuple[bool, bytes]:
    """Answer at once, and take so much memory after that."""

    def grow() -> None:
        _grow(mebibytes)

    call.defer_optional(grow)
    return True, b"answered"


def _answer_and_end(_value: str, call: Call) -> tuple[bool, bytes]:
    call.defer_required(lambda: os._exit(0))
    return True, b"last words"


def _go_on(path: str, call: Call) -> tuple[bool, bytes]:
    """Answer at once, and go on in 30 parts, as `engine.prepare` does; each that is done is a byte in a file."""

    def prepare() -> None:
        deadline = Deadline(is_cancelled=call.is_awaited)
        with Path(path).open("ab", buffering=0) as file:
            for part in range(30):
                deadline.check(f"part {part}")
                time.sleep(0.02)
                file.write(b".")

    call.defer_optional(prepare)
    return True, b"goes on"


_TALKATIVE = {
    "go_on": _go_on,
    "answer_and_end": _answer_and_end,
    "give_way": _give_way,
    "last_word": _last_word,
    "owe": _owe,
    "grow after": _grow_after,
    "use": _use,
    "until_cancelled": _until_cancelled,
    "tell": _tell,
    "prepare": _prepare,
}
_VERBS = {
    "exit": _exit,
    "grow": _grow,
    "allocate": _allocate,
    "echo": _echo,
    "pid": _pid,
    "sleep": _sleep,
    "until_there": _until_there,
    "mark": _mark_and_sleep,
    "segfault": _segfault,
    "stuck": _stuck_in_a_native_call,
    "refuse": _refuse,
}


def converse(line: Connection) -> None:
    """Answers what is an echo, and ends when it is told to."""
    line.send(os.getpid())
    while True:
        what, value = line.recv()
        if what == "end":
            return
        line.send(value)
        line.send(Taken(1))


def converse_with_nobody(line: Connection) -> None:
    """Takes nothing."""
    line.send(os.getpid())
    threading.Event().wait()


@dataclass(frozen=True)
class StreamInWords:
    """A stream's conversation that says what it is told to."""

    encoding: Encoding = Encoding.JSON
    refuses: bool = False

    def __call__(self, line: Connection) -> None:
        if self.refuses:
            line.send(RefusedOpening(make_error_reply(RobotInvalid("there is no robot 'ur55'"))))
            return
        line.send(Open("ur5", ("a",), (0.5,), 1, ("odd",)))
        with contextlib.suppress(EOFError):
            while True:
                asked = line.recv()
                if isinstance(asked, Update):
                    line.send(Publication("pieces", asked.payload, 7, 1.5))
                    line.send(Taken(1))
