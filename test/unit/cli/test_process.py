"""The command line as a process: its streams, names of files, signals, and installation."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest


def program(*arguments, **options):
    """Run the command line as a process."""
    command = [sys.executable, "-m", "map_racing", *map(str, arguments)]
    pipe = subprocess.PIPE
    return subprocess.run(command, **{"stdout": pipe, "stderr": pipe, "check": False, **options})


def test_names_that_are_not_utf8_on_a_terminal_that_knows_no_umlauts(bags, tmp_path):
    name = b"r\xfcn.bag"
    paths = [os.fsdecode(os.fsencode(str(tmp_path)) + b"/" + name)]
    paths.append(str(tmp_path / "ru\u0308n_\u8d5b.bag"))
    for path in paths:
        shutil.copy(str(bags["map"]), path)
    written = ["--csv", tmp_path / "l.csv", "--json", tmp_path / "l.json"]
    done = program("evaluate", *paths, *written, env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert (done.returncode, done.stderr) == (0, b"")
    assert name in (tmp_path / "l.csv").read_bytes()
    runs = json.loads((tmp_path / "l.json").read_text())["runs"]
    assert [run["bag"] for run in runs] == paths
    assert b"n_\\u8d5b.bag" in done.stdout


def test_without_any_stream(bags, tmp_path):
    report = tmp_path / "l.json"
    command = f'exec "{sys.executable}" -m map_racing evaluate "$0" --json "$1" <&- >&- 2>&-'
    subprocess.run(["sh", "-c", command, str(bags["map"]), str(report)], check=True)
    assert json.loads(report.read_text())["runs"][0]["summary"]["laps_completed"] == 2


def unread():
    """A pipe whose reader has ended."""
    reader, writer = os.pipe()
    os.close(reader)
    return writer


@pytest.mark.parametrize(
    ("words", "unbuffered"),
    [("--help", ""), ("raceline --help", ""), ("evaluate BAG", ""), ("evaluate BAG", "1")],
)
def test_a_reader_that_ends_first_ends_it_silently(bags, words, unbuffered):
    words = [str(bags["map"]) if word == "BAG" else word for word in words.split()]
    environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
    done = program(*words, stdout=unread(), env=environment)
    assert (done.returncode, done.stderr) == (141, b"")


def test_a_table_to_a_reader_that_ends_first(bags):
    done = program("evaluate", bags["map"], "--csv", "/dev/stdout", stdout=unread())
    assert (done.returncode, done.stderr) == (141, b"")


def test_errors_that_nobody_reads(tmp_path):
    done = program("evaluate", tmp_path / "none.bag", stderr=unread())
    assert (done.returncode, done.stdout) == (141, b"")


def test_an_output_on_a_full_disk_is_one_line():
    with open("/dev/full", "w") as full:
        done = program("raceline", "check", "reference", stdout=full)
    assert (done.returncode, done.stderr) == (1, b"map-racing: No space left on device\n")


SCRIPTS = Path(__file__).resolve().parents[3] / "scripts"


def script(name, *arguments, **options):
    """Run a script of a checkout without installing it."""
    environment = {**os.environ, "PYTHONPATH": "", "PYTHONUNBUFFERED": ""}
    command = [sys.executable, *arguments[:1], str(SCRIPTS / name), *arguments[1:]]
    return subprocess.run(command, stderr=subprocess.PIPE, env=environment, check=False, **options)


def test_scripts_where_libraries_are_missing():
    names = [path.name for path in SCRIPTS.iterdir() if b"python3\n" in path.read_bytes()[:30]]
    assert {"heats", "latency", "controller", "map-racing"} <= set(names)
    for name in (*names, "benchmark.py"):
        # -S: only Python's standard library.
        done = script(name, "-S", *(["race", "--output", "a"] if name == "map-racing" else []))
        lines = done.stderr.decode().splitlines()
        assert len(lines) == 1 and "has no module" in lines[0], (name, lines)


def test_scripts_whose_reader_ends_first():
    done = script("laps_to_car", "-B", "--help", stdout=unread())
    assert (done.returncode, done.stderr) == (141, b"")


def test_an_error_of_a_script_is_one_line(tmp_path):
    done = script("false_stops", "-B", "--grid", str(tmp_path / "none.yaml"))
    assert done.returncode == 1 and len(done.stderr.splitlines()) == 1


def test_an_interrupt_is_one_line_and_leaves_nothing(tmp_path):
    command = [sys.executable, "-m", "map_racing", "race", "--laps", "1000"]
    process = subprocess.Popen(
        [*command, "--output", str(tmp_path / "a.bag")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        # A script may start the tests in the background, where interrupts are ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    process.stdout.readline()  # the race has started
    process.send_signal(signal.SIGINT)
    _, err = process.communicate()
    assert (process.returncode, err) == (130, b"map-racing: interrupted\n")
    assert list(tmp_path.iterdir()) == []


def test_too_little_memory_is_one_line(refused, monkeypatch):
    def exhausted(_):
        raise MemoryError

    monkeypatch.setattr("map_racing.cli.lookup.load_table", exhausted)
    assert "not enough memory" in refused("lookup", "check", "table.csv")


@pytest.mark.once
def test_installed_copy_finds_its_data(tmp_path):
    """Installed by pip, without the source tree: command, packages and data files."""
    source = __file__[: __file__.index("/test/unit/")]
    copy = tmp_path / "source"
    ignore = shutil.ignore_patterns(".git", "results", "build", "*.egg-info", "test")
    shutil.copytree(source, str(copy), ignore=ignore)
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--disable-pip-version-check"]
    subprocess.run([*pip, "--target", str(tmp_path / "target"), str(copy)], check=True)
    code = (
        "from map_racing.cli import main; import map_racing, sys\n"
        f"assert map_racing.__file__.startswith({str(tmp_path / 'target')!r})\n"
        "sys.exit(main(['race', '--laps', '1', '--output', 'a.bag']))"
    )
    environment = {"PYTHONPATH": str(tmp_path / "target"), "PATH": "/usr/bin:/bin"}
    # Where its libraries lie compiled.
    environment["PYTHONPYCACHEPREFIX"] = os.environ.get("PYTHONPYCACHEPREFIX", "")
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=str(tmp_path),
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""  # no progress bar where stderr is no terminal
    assert (tmp_path / "a.bag").is_file()
