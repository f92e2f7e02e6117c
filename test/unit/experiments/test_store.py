"""Results on disk: unchanged when read back, and never incomplete."""

import json
import math

import pytest

from map_racing.errors import FileFormatError, MapRacingError
from map_racing.experiments.jobs import LAP_COLUMNS, execute
from map_racing.experiments.store import Store


@pytest.fixture(scope="module")
def crashed(job_of):
    job = job_of(scale=1.9)
    return job, execute(job, path=True, bag=True)


def same(a, b):
    """Equal to the last bit, with NaN equal to itself."""
    return repr(a) == repr(b)


def test_results_come_back_bit_for_bit(tmp_path, crashed):
    job, executed = crashed
    store = Store(tmp_path)
    assert store.find(job) is None
    store.keep(job, executed.result)
    found = Store(tmp_path).find(job, path=True)
    assert same(found, executed.result)
    assert math.isnan(found.stretches[0].lap_time_s) and found.path
    assert [path.name for path in tmp_path.iterdir()] == ["runs"]


def test_another_job_is_not_found(tmp_path, crashed, job_of):
    store = Store(tmp_path)
    store.keep(crashed[0], crashed[1].result)
    assert store.find(job_of(scale=1.9, seed=2)) is None


def test_what_is_needed_must_be_there(tmp_path, crashed):
    job, executed = crashed
    store = Store(tmp_path)
    store.keep(job, executed.result._replace(path=()))
    assert store.find(job) is not None
    assert store.find(job, path=True) is None
    assert store.find(job, bag=True) is None
    store.keep(job, executed.result, executed.bag)
    assert same(store.find(job, path=True, bag=True), executed.result)
    assert (tmp_path / "bags" / f"{job.file_stem}.bag").read_bytes() == executed.bag


def test_results_of_another_directory_are_taken_over(tmp_path, crashed):
    job, executed = crashed
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    Store(tmp_path / "a").keep(job, executed.result, executed.bag)
    store = Store(tmp_path / "b", reuse=[tmp_path / "a"])
    assert same(store.find(job, bag=True), executed.result)
    assert same(Store(tmp_path / "b").find(job, bag=True), executed.result)
    with pytest.raises(MapRacingError, match="c: expected a result directory"):
        Store(tmp_path / "b", reuse=[tmp_path / "c"])


@pytest.mark.parametrize("content", ["", "{", "[]", "{}", '{"result": {"outcome": "completed"}}'])
def test_a_broken_file_is_named(tmp_path, crashed, content):
    job, executed = crashed
    store = Store(tmp_path)
    store.keep(job, executed.result)
    path = tmp_path / "runs" / f"{job.fingerprint}.json"
    path.write_text(content)
    with pytest.raises(FileFormatError, match=f"{job.fingerprint}.json: expected the result"):
        store.find(job)


@pytest.mark.parametrize(
    "change",
    [
        {"outcome": 5},
        {"outcome": "won"},
        {"duration_s": "long"},
        {"path": [["a", 1.0, 2.0]]},
        {"stretches": [dict.fromkeys(LAP_COLUMNS, "x")]},
    ],
)
def test_a_file_with_impossible_values_is_named(tmp_path, crashed, change):
    job, executed = crashed
    store = Store(tmp_path)
    store.keep(job, executed.result)
    path = tmp_path / "runs" / f"{job.fingerprint}.json"
    record = json.loads(path.read_text())
    record["result"].update(change)
    path.write_text(json.dumps(record))
    with pytest.raises(FileFormatError, match=f"{job.fingerprint}.json: expected the result"):
        store.find(job)
