"""Plans and their races: on disk at once, driven only once, in any order."""

import os
import pickle
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool

import pytest

from map_racing.errors import MapRacingError
from map_racing.experiments import campaign
from map_racing.experiments.campaign import Plan, carry_out
from map_racing.experiments.executors import SerialExecutor
from map_racing.experiments.jobs import Executed, RaceResult, code_fingerprint
from map_racing.experiments.store import Store


@pytest.fixture
def driven(monkeypatch):
    """Seeds in the order of driving, with an instant fake race."""
    seeds = []

    def execute(job, path, bag):
        seeds.append(job.seed)
        result = RaceResult("completed" if job.seed < 100 else "crashed", (), float(job.seed))
        return Executed(result, b"bag" if bag else None, 0.5, code_fingerprint())

    monkeypatch.setattr(campaign, "execute", execute)
    return seeds


class LastFirst(Executor):
    """Finishes the last submitted job first."""

    def __init__(self, given=3):
        self._given, self._pending = given, []

    def submit(self, fn, *args):
        future = Future()
        self._pending.append((future, fn, args))
        if len(self._pending) == self._given:
            for waiting, function, arguments in reversed(self._pending):
                waiting.set_result(function(*arguments))
            self._pending = []
        return future


def listed(job_of, *batches):
    """Plan with batches of seeds; its result is the list of durations."""

    def steps():
        durations = []
        for batch in batches:
            results = yield [job_of(seed=seed) for seed in batch]
            durations.append([result.duration_s for result in results])
        return durations

    return Plan(steps(), sum(map(len, batches)))


@pytest.mark.parametrize("executor", [SerialExecutor(), LastFirst()])
def test_results_come_in_the_order_of_the_plan(job_of, tmp_path, driven, executor):
    plans = [listed(job_of, [1, 2, 3], [4, 5, 6])]
    results, effort = carry_out(plans, Store(tmp_path), executor, 3)
    assert results == [[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]]
    assert effort == (6, 0, 3.0, 21.0)
    assert sorted(driven) == [1, 2, 3, 4, 5, 6]


def test_a_plan_decides_by_results(job_of, tmp_path, driven):
    def until_crash():
        for seed in (98, 99, 100, 101):
            (result,) = yield [job_of(seed=seed)]
            if not result.completed:
                return seed

    assert carry_out([Plan(until_crash(), 4)], Store(tmp_path), SerialExecutor(), 1)[0] == [100]
    assert driven == [98, 99, 100]


def test_what_two_plans_want_is_driven_once(job_of, tmp_path, driven):
    plans = [listed(job_of, [1, 2], [7]), listed(job_of, [2, 1, 2]), listed(job_of, [7])]
    results, effort = carry_out(plans, Store(tmp_path), SerialExecutor(), 1)
    assert results == [[[1.0, 2.0], [7.0]], [[2.0, 1.0, 2.0]], [[7.0]]]
    assert sorted(driven) == [1, 2, 7]


def test_what_is_on_disk_is_not_driven(job_of, tmp_path, driven):
    first = carry_out([listed(job_of, [1, 2])], Store(tmp_path), SerialExecutor(), 1)
    again, effort = carry_out([listed(job_of, [1, 2], [3])], Store(tmp_path), SerialExecutor(), 1)
    assert again == [[*first[0][0], [3.0]]]
    assert driven == [1, 2, 3]
    assert effort == (1, 2, 0.5, 3.0)


def test_a_plan_without_races_is_done(job_of, tmp_path, driven):
    plans = [listed(job_of), listed(job_of, [], [1])]
    assert carry_out(plans, Store(tmp_path), SerialExecutor(), 1)[0] == [[], [[], [1.0]]]


def test_bags_are_kept_where_they_are_asked_for(job_of, tmp_path, driven):
    carry_out([listed(job_of, [1])], Store(tmp_path), SerialExecutor(), 1, bags=True)
    (bag,) = (tmp_path / "bags").iterdir()
    assert bag.read_bytes() == b"bag"


def test_what_was_driven_before_an_error_is_on_disk(job_of, tmp_path, driven, monkeypatch):
    good = campaign.execute

    def fails_at_3(job, path, bag):
        if job.seed == 3:
            raise MapRacingError("no grip")
        return good(job, path, bag)

    monkeypatch.setattr(campaign, "execute", fails_at_3)
    with pytest.raises(MapRacingError, match="no grip"):
        carry_out([listed(job_of, [1, 2, 3, 4])], Store(tmp_path), SerialExecutor(), 1)
    assert len(list((tmp_path / "runs").iterdir())) == 2


def test_other_code_on_a_worker_is_refused(job_of, tmp_path, driven, monkeypatch):
    monkeypatch.setattr(campaign, "code_fingerprint", lambda: "other")
    with pytest.raises(MapRacingError, match="another version of map_racing"):
        carry_out([listed(job_of, [1])], Store(tmp_path), SerialExecutor(), 1)


def test_a_process_that_dies_is_one_line(job_of, tmp_path):
    class Dying(Executor):
        def submit(self, fn, *args):
            future = Future()
            future.set_exception(BrokenProcessPool("terminated abruptly"))
            return future

    with pytest.raises(MapRacingError, match="a process died; what was finished is on disk"):
        carry_out([listed(job_of, [1])], Store(tmp_path), Dying(), 1)


def test_expected_number_of_races_follows_what_is_known(job_of, tmp_path, driven, monkeypatch):
    totals = []

    class Bar(campaign.tqdm):
        def refresh(self, *args, **kwargs):
            totals.append((self.n, self.total))

    monkeypatch.setattr(campaign, "tqdm", Bar)
    plan = Plan(listed(job_of, [1], [2], [3]).steps, 10)
    carry_out([plan], Store(tmp_path), SerialExecutor(), 1)
    assert totals[0] == (0, 10) and totals[-1] == (3, 3)


SWEEP = """
import pickle, sys
from pathlib import Path
from map_racing.experiments.campaign import Plan, carry_out
from map_racing.experiments.executors import open_executor
from map_racing.experiments.store import Store

def sweep(jobs, folder):
    folder.mkdir(exist_ok=True)
    def steps():
        results = []
        for job in jobs:
            results += yield [job]
        return results
    with open_executor(1) as (executor, capacity):
        return carry_out([Plan(steps(), len(jobs))], Store(folder), executor, capacity)

if __name__ == "__main__":
    sweep(pickle.loads(Path(sys.argv[1]).read_bytes()), Path(sys.argv[2]))
"""


@pytest.mark.once
def test_a_killed_sweep_goes_on_where_it_stopped(job_of, tmp_path):
    """A real process is killed; its finished races are not driven again."""
    jobs = [job_of(seed=seed, laps=6) for seed in range(8)]
    (tmp_path / "sweep.py").write_text(SWEEP)
    (tmp_path / "jobs").write_bytes(pickle.dumps(jobs))
    killed = tmp_path / "killed"
    command = [sys.executable, tmp_path / "sweep.py", tmp_path / "jobs", killed]
    with subprocess.Popen(list(map(str, command))) as process:
        until = time.monotonic() + 60.0
        while len(list(killed.glob("runs/*.json"))) < 2 and time.monotonic() < until:
            assert process.poll() is None
            time.sleep(0.01)
        os.kill(process.pid, signal.SIGKILL)
    finished = {path.name: path.stat().st_mtime_ns for path in killed.glob("runs/*.json")}
    assert 2 <= len(finished) < 8

    program = {"__name__": "sweep"}
    exec(SWEEP, program)
    results, effort = program["sweep"](jobs, killed)
    assert (effort.driven, effort.found) == (8 - len(finished), len(finished))
    again = {path.name: path.stat().st_mtime_ns for path in killed.glob("runs/*.json")}
    assert {name: again[name] for name in finished} == finished
    undisturbed, _ = program["sweep"](jobs, tmp_path / "undisturbed")
    assert repr(results) == repr(undisturbed)
    for name in again:
        first, second = ((tmp_path / run / "runs" / name) for run in ("killed", "undisturbed"))
        assert first.read_bytes() == second.read_bytes()
