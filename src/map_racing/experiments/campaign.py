"""Many races, planned step by step: finished ones are read from disk, the others driven.

A plan is a generator: it yields lists of jobs, receives the list of their results in the same order
to decide what to drive next, and returns its result. Plans advance independently of each other,
whatever the order and place in which their races are driven.
"""

from __future__ import annotations

from collections import deque
from concurrent.futures import Executor
from typing import Any, Generator, NamedTuple

from tqdm import tqdm

from ..errors import MapRacingError
from .executors import carried_out
from .jobs import code_fingerprint, execute
from .store import Store

__all__ = ["Effort", "Plan", "carry_out"]


class Plan(NamedTuple):
    """A generator of jobs, and the approximate number of jobs."""

    steps: Generator
    expected: int


class Effort(NamedTuple):
    """Cost of a campaign.

    Races driven, races found on disk, and processor time and simulated time of the former [s].
    """

    driven: int
    found: int
    cpu_s: float
    simulated_s: float

    def __add__(self, other):
        return Effort(*(a + b for a, b in zip(self, other)))


def carry_out(
    plans: list[Plan],
    store: Store,
    executor: Executor,
    capacity: int,
    *,
    path: bool = False,
    bags: bool = False,
    title: str = "races",
) -> tuple[list[Any], Effort]:
    """Carry out plans.

    Parameters
    ----------
    plans : list of Plan
    store : Store
        Searched before a race is driven; each result is stored at once.
    executor : concurrent.futures.Executor
    capacity : int
        Largest number of submitted jobs.
    path, bags : bool
        Whether results need the driven path, and their bags.
    title : str
        Of the progress bar.

    Returns
    -------
    results : list
        The results of the plans.
    Effort

    Raises
    ------
    MapRacingError
        If a process died, or a worker of a cluster has other code.
    """
    campaign = _Campaign(plans, store, path, bags)

    def draw():
        job = campaign.waiting.popleft() if campaign.waiting else None
        return job and (job, execute, job, path, bags)

    with tqdm(total=campaign.expected, desc=title, unit="race", disable=None, leave=False) as bar:
        campaign.show(bar)
        for job, executed in carried_out(executor, capacity, draw):
            if executed.code != code_fingerprint():
                raise MapRacingError("a worker of the cluster has another version of map_racing")
            campaign.take(job, executed)
            campaign.show(bar)
    return campaign.results, campaign.effort


class _Campaign:
    """The races still to be driven, and the plans that wait for them."""

    def __init__(self, plans, store, path, bags):
        self.waiting = deque()
        self.results = [None] * len(plans)
        self.driven = self.found = 0
        self.cpu_s = self.simulated_s = 0.0
        self._plans, self._store, self._needs = plans, store, (path, bags)
        self._batches = {}  # plan -> results of the jobs it waits for, None if pending
        self._wanted = {}  # fingerprint -> (plan, place in its batch) that waits for it
        self._done = [0] * len(plans)
        for index in range(len(plans)):
            self._advance(index, None)

    def take(self, job, executed):
        """Store a driven race, and advance the plans that waited for it."""
        self._store.keep(job, executed.result, executed.bag)
        self.driven += 1
        self.cpu_s += executed.cpu_s
        self.simulated_s += executed.result.duration_s
        for index, place in self._wanted.pop(job.fingerprint):
            self._batches[index][place] = executed.result
            self._done[index] += 1
            if None not in self._batches[index]:
                self._advance(index, self._batches.pop(index))

    def _advance(self, index, results):
        """Send results to a plan until it needs a race that must be driven."""
        steps = self._plans[index].steps
        while True:
            try:
                jobs = steps.send(results)
            except StopIteration as stop:
                self.results[index] = stop.value
                return
            results = []
            for place, job in enumerate(jobs):
                result, key = None, job.fingerprint
                if key not in self._wanted:
                    result = self._store.find(job, *self._needs)
                results.append(result)
                if result is not None:
                    self.found += 1
                    self._done[index] += 1
                    continue
                if key not in self._wanted:
                    self.waiting.append(job)
                self._wanted.setdefault(key, []).append((index, place))
            if None in results:
                self._batches[index] = results
                return

    @property
    def effort(self):
        """Cost so far, as an `Effort`."""
        return Effort(self.driven, self.found, self.cpu_s, self.simulated_s)

    @property
    def expected(self):
        """Races of all plans, as far as known."""
        return sum(
            self._done[index]
            if index not in self._batches
            else max(plan.expected, self._done[index] + self._batches[index].count(None))
            for index, plan in enumerate(self._plans)
        )

    def show(self, bar):
        """Show progress; races found on disk must not affect the estimate of the rest."""
        bar.total = self.expected
        bar.initial = self.found
        bar.n = sum(self._done)
        bar.refresh()
