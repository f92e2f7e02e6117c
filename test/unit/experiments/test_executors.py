"""Results do not depend on where jobs run."""

import os
import subprocess
import sys

import pytest

from map_racing.errors import MapRacingError, ParameterError
from map_racing.experiments.campaign import Plan, carry_out
from map_racing.experiments.executors import SerialExecutor, open_executor
from map_racing.experiments.store import Store


def plans(job_of):
    """Two days at rising speeds; the first result of each decides its second speed."""

    def steps(seed):
        given = yield [job_of(seed=seed), job_of(seed=seed, scale=0.8)]
        scale = 0.6 + given[0].laps[0].rms_lateral_error_m
        given += yield [job_of(seed=seed, scale=scale)]
        return given

    return [Plan(steps(seed), 3) for seed in (1, 2)]


def carried_out(job_of, folder, **where):
    folder.mkdir()
    with open_executor(**where) as (executor, capacity):
        results, effort = carry_out(plans(job_of), Store(folder), executor, capacity)
    assert effort.driven == 6
    files = {path.name: path.read_bytes() for path in (folder / "runs").iterdir()}
    return results, files


@pytest.mark.once
def test_serial_processes_and_dask_agree_bit_for_bit(job_of, tmp_path):
    from distributed import LocalCluster

    serial = carried_out(job_of, tmp_path / "serial", jobs=1)
    assert len(serial[1]) == 6
    processes = carried_out(job_of, tmp_path / "processes", jobs=2)
    options = {"processes": True, "threads_per_worker": 2, "dashboard_address": None}
    with LocalCluster(n_workers=1, **options) as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tcp://")
        dask = carried_out(job_of, tmp_path / "dask", scheduler=address)
    assert repr(serial) == repr(processes) == repr(dask)


def test_serial_keeps_errors_for_whoever_asks():
    future = SerialExecutor().submit(int, "no number")
    assert future.done()
    with pytest.raises(ValueError):
        future.result()


def test_an_interruption_does_not_reach_a_process_that_starts(tmp_path):
    """Before it has loaded what would make it ignore the interruption."""
    script = tmp_path / "script.py"
    script.write_text(
        "import os, signal\n"
        "from map_racing.experiments.executors import carried_out, open_executor\n"
        "if __name__ == '__main__':\n"
        "    jobs = iter([('one', abs, -1), ('two', abs, -2)])\n"
        "    with open_executor(jobs=2) as (executor, capacity):\n"
        "        done = carried_out(executor, capacity, lambda: next(jobs, None))\n"
        "        print(sorted(done))\n"
        "else:\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True)
    assert done.stdout == "[('one', 1), ('two', 2)]\n" and done.stderr == ""


def test_processes_have_one_thread_each_and_the_environment_stays_as_it_was(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    with open_executor(2) as (executor, capacity):
        assert capacity >= 2
        names = ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"]
        assert list(executor.map(os.getenv, names)) == ["1", "1"]
    assert "OMP_NUM_THREADS" not in os.environ and os.environ["OPENBLAS_NUM_THREADS"] == "7"


def test_one_job_for_each_core_by_default():
    with open_executor() as (executor, _):
        processes = getattr(executor, "_max_workers", 1)
    assert processes == len(os.sched_getaffinity(0))


def test_nobody_outlives_the_parent():
    """Worker processes end by themselves when their parent is killed."""
    code = (
        "import os, signal\n"
        "from map_racing.experiments.executors import open_executor\n"
        "if __name__ == '__main__':\n"
        "    with open_executor(2) as (executor, _):\n"
        "        print(executor.submit(int, 5).result(), flush=True)\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
        # The pipe closes only when the last process that has it open is gone.
        printed = process.communicate(timeout=60)[0]
    assert (printed, process.returncode) == (b"5\n", -9)


@pytest.mark.parametrize("jobs", [0, -2])
def test_no_processes_are_refused(jobs):
    with pytest.raises(ParameterError, match=f"at least 1, got {jobs}"), open_executor(jobs):
        pass


def test_a_scheduler_decides_on_its_workers():
    where = open_executor(jobs=2, scheduler="tcp://127.0.0.1:1")
    with pytest.raises(ParameterError, match="expected none with a scheduler"), where:
        pass


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nowhere://x", "127.0.0.1:notaport"])
def test_a_scheduler_that_does_not_answer(address, monkeypatch):
    monkeypatch.setattr("map_racing.experiments.executors._PATIENCE", 1.0)
    where = open_executor(scheduler=address)
    with pytest.raises(MapRacingError, match="no Dask scheduler answers") as caught, where:
        pass
    assert address in str(caught.value) and "\n" not in str(caught.value)


def test_a_scheduler_without_workers():
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=0, processes=False, protocol="tcp://", dashboard_address=None
    ) as cluster:
        where = open_executor(scheduler=cluster.scheduler_address)
        with pytest.raises(MapRacingError, match="has no workers"), where:
            pass


def test_without_dask_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    where = open_executor(scheduler="tcp://127.0.0.1:1")
    with pytest.raises(MapRacingError, match=r"pip install 'map_racing\[cluster\]'"), where:
        pass
