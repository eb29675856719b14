"""Copies of a process that become others: what they get, what they have nothing of, and when they end.

Each test is a program of its own: what runs the tests has threads, beside which nothing is copied.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from tests.bench.whole_runs import config

_BEGIN = """
import os, signal, subprocess, sys, threading, time
from pathlib import Path
from hilbench.forked_workers import forked_workers
folder = Path(sys.argv[1])
def so_many(count):
    return dict.fromkeys(range(count), lambda: None)
"""


def program(folder: Path, text: str) -> subprocess.Popen[str]:
    """Its module `told` is beside it in `folder`, where it is run."""
    (folder / "program.py").write_text(_BEGIN + text)
    command = [sys.executable, str(folder / "program.py"), str(folder)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)


def done(folder: Path, text: str) -> None:
    process = program(folder, text)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (0, "", "")


def gone(pid: int) -> bool:
    """Whether it has ended, within 20 s; one that nobody waits for any more has."""
    for _ in range(2000):
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            return True
        if state == "Z":
            return True
        time.sleep(0.01)
    return False


def test_a_copy_is_what_a_new_interpreter_would_be(tmp_path: Path) -> None:
    (tmp_path / "told.py").write_text("""if True:
        import os, signal, sys
        from pathlib import Path
        print(__name__, sys.argv[1:], os.environ["ADDED"], os.environ["KEPT"], os.getsid(0) == os.getpid())
        print(Path("/proc/self/cmdline").read_bytes() == b"\\0".join(map(os.fsencode, sys.orig_argv)) + b"\\0"
              or Path("/proc/self/cmdline").read_bytes() == os.fsencode(sys.executable) + b"\\0-m\\0told\\0a b\\0c\\0")
        print(Path("/proc/self/comm").read_text().strip())
        print([signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1)])
        print(signal.pthread_sigmask(signal.SIG_BLOCK, []))
        print("an error", file=sys.stderr)
        print(repr(sys.stdin.read()))
        sys.exit(7)
    """)
    done(
        tmp_path,
        """if True:
        os.environ["KEPT"] = "kept"
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1):
            signal.signal(number, lambda *_: None)
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        with forked_workers(so_many(1)) as waiting:
            copy = waiting.popitem()[1]
            copy.become(["told", "a b", "c"], folder / "copy.log", {"ADDED": "added"})
            copy.stdin.close()
            assert copy.wait(30.0) == 7
            assert copy.poll() == 7
            copy.terminate()  # one that has ended is nobody else
    """,
    )
    new = subprocess.run(
        ["nohup", sys.executable, "-m", "told", "a b", "c"],
        cwd=tmp_path,
        env=os.environ | {"ADDED": "added", "KEPT": "kept"},
        stdin=subprocess.DEVNULL,
        stdout=(tmp_path / "new.log").open("wb"),
        stderr=subprocess.STDOUT,
        start_new_session=True,
        check=False,
    )
    assert new.returncode == 7
    lines = sorted((tmp_path / "copy.log").read_text().splitlines())
    assert lines == sorted((tmp_path / "new.log").read_text().splitlines())
    assert "True" in lines


def test_a_copy_has_no_file_of_who_made_it_and_takes_its_numbers_for_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "told.py").write_text("""if True:
        import os, stat
        ours = os.open("/proc/self/status", os.O_RDONLY)
        print(ours, len([number for number in range(ours) if stat.S_ISFIFO(os.fstat(number).st_mode)]))
    """)
    done(
        tmp_path,
        """if True:
        receives, sends = os.pipe()
        with forked_workers(so_many(2)) as waiting:
            os.close(sends)
            assert os.read(receives, 1) == b""  # nobody has the other end, while both wait
            copy = waiting.popitem()[1]
            copy.become(["told"], folder / "copy.log", {})
            assert copy.wait(30.0) == 0
            number, pipes = (folder / "copy.log").read_text().split()
            assert int(number) > max(receives, sends)
            assert pipes == "1"  # its standard input
    """,
    )


def test_forked_workers_that_are_not_needed_end_with_the_block_and_with_the_process(tmp_path: Path) -> None:
    done(
        tmp_path,
        """if True:
        with forked_workers(so_many(2)) as waiting:
            kept = list(waiting.values())
            assert [copy.poll() for copy in kept] == [None, None]
        assert [copy.returncode for copy in kept] == [0, 0]
    """,
    )
    process = program(
        tmp_path,
        """if True:
        with forked_workers(so_many(2)) as waiting:
            print(*(copy.pid for copy in waiting.values()), flush=True)
            time.sleep(60)
    """,
    )
    assert process.stdout is not None
    pids = [int(word) for word in process.stdout.readline().split()]
    os.killpg(process.pid, signal.SIGINT)  # as at a terminal: it is this process' to end
    assert process.wait(30) != 0
    assert len(pids) == 2
    assert all(map(gone, pids))
    killed = program(tmp_path, (tmp_path / "program.py").read_text().removeprefix(_BEGIN))
    assert killed.stdout is not None
    pids = [int(word) for word in killed.stdout.readline().split()]
    os.kill(killed.pid, signal.SIGKILL)
    killed.wait(30)
    assert all(map(gone, pids))
    for each in (process, killed):
        each.communicate()


def test_a_copy_prepares_itself_while_the_other_process_goes_on_and_what_fails_then_is_nobodys(tmp_path: Path) -> None:
    (tmp_path / "told.py").write_text("import copies_know; print(copies_know.prepared)")
    done(
        tmp_path,
        """if True:
        import types
        def prepare(name):
            sys.modules["copies_know"] = known = types.ModuleType("copies_know")
            known.prepared = name
            if name == "fails":
                raise RuntimeError("nobody hears it")
        with forked_workers({name: lambda name=name: prepare(name) for name in ("one", "fails")}) as waiting:
            assert "copies_know" not in sys.modules
            for name in list(waiting):
                copy = waiting.pop(name)
                copy.become(["told"], folder / f"{name}.log", {})
                assert copy.wait(30.0) == 0
                assert (folder / f"{name}.log").read_text() == name + "\\n"
    """,
    )


def test_it_is_waited_for_until_a_copy_is_prepared_also_where_that_fails(tmp_path: Path) -> None:
    done(
        tmp_path,
        """if True:
        def prepares():
            time.sleep(0.1)
            (folder / "prepared").touch()
        def fails():
            raise RuntimeError("nobody hears it")
        def ends():
            os._exit(1)
        with forked_workers({"prepares": prepares, "fails": fails, "ends": ends}) as waiting:
            for name in ("fails", "prepares", "ends", "prepares"):
                waiting[name].wait_until_prepared()
            assert (folder / "prepared").exists()
    """,
    )


def test_nothing_is_copied_beside_other_threads(tmp_path: Path) -> None:
    done(
        tmp_path,
        """if True:
        left = threading.Event()
        thread = threading.Thread(target=left.wait)
        thread.start()
        with forked_workers(so_many(2)) as waiting:
            assert waiting == {}
        left.set()
        thread.join()
        with forked_workers(so_many(2)) as waiting:
            assert len(waiting) == 2
    """,
    )


def test_what_nobody_foresaw_in_a_copy_is_a_line_in_its_log_and_one_that_is_gone_is_not_taken(tmp_path: Path) -> None:
    (tmp_path / "told.py").write_text("raise ZeroDivisionError('unforeseen')\n")
    done(
        tmp_path,
        """if True:
        from hilbench.processes import ChildProcess
        with forked_workers(so_many(3)) as waiting:
            child = ChildProcess("it", ["told"], folder / "copy.log", copy=waiting.popitem()[1])
            assert child._process.wait(30.0) == 3 and child.ended
            line, = (folder / "copy.log").read_text().splitlines()
            assert line.startswith("hilbench: unexpected ZeroDivisionError in forked_workers.py:")
            assert "unforeseen; tr" in line
            child.restart()  # a new interpreter
            assert child._process.wait(30.0) == 1
            child.end()
            copy = waiting.popitem()[1]
            os.kill(copy.pid, signal.SIGKILL)
            assert copy.wait(30.0) == -signal.SIGKILL
            in_its_place = ChildProcess("it", ["told"], folder / "copy.log", copy=copy)
            assert in_its_place._process.wait(30.0) == 1
            in_its_place.end()
    """,
    )


def test_the_processes_of_a_run_are_copies_of_it(tmp_path: Path) -> None:
    path = config(tmp_path, steps=[{"hold": {"duration_s": 0.02}}])
    done(
        tmp_path,
        f"""if True:
        from types import SimpleNamespace
        from hilbench import processes
        from hilbench.results.run import run_experiment
        from hilbench.runs.config import load_with_overrides
        from hilbench.topology import resolved
        def new_interpreter(*_, **__):
            raise AssertionError("a new interpreter")
        def read_again(path):
            raise AssertionError("it has the config already")
        resolved.read_resolved = read_again
        processes.subprocess = SimpleNamespace(Popen=new_interpreter, TimeoutExpired=subprocess.TimeoutExpired)
        outcome = run_experiment(load_with_overrides(Path({str(path)!r})), folder / "runs")
        assert outcome.exit_code == 0, outcome.as_object()
        assert outcome.result.timing.lost_frames == 0  # each has said so at its end
    """,
    )
