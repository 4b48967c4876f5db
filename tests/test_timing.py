"""The clock, the median and the spread behind every table and chart of times, under clocks that are made up."""

import math
import time

import jax
import pytest

from midlie_jax.advice import timing
from midlie_jax.advice.timing import Load, Stopwatch, Timing, timed, timed_in_turn


class Machine:
    """Two clocks that go on by one at every reading; the wall's by `busy` times as much, both by `slow` times."""

    def __init__(self):
        self.busy = self.slow = 1.0
        self.wall = self.processor = 0.0

    def perf_counter(self) -> float:
        self.wall += self.busy * self.slow
        return self.wall

    def process_time(self) -> float:
        self.processor += self.slow
        return self.processor


@pytest.fixture
def machine(monkeypatch):
    made = Machine()
    monkeypatch.setattr(time, "perf_counter", made.perf_counter)
    monkeypatch.setattr(time, "process_time", made.process_time)
    return made


def test_a_timing_is_the_median_and_half_the_middle_half():
    watch = Stopwatch()
    watch.laps = [10.0, 1.0, 2.0, 3.0, 4.0]
    assert watch.timing() == Timing(3.0, pytest.approx((4 - 2) / 2 / 3))
    watch.laps = [5.0]
    assert watch.timing().seconds == 5.0
    assert math.isnan(watch.timing().spread)


def test_the_first_of_many_runs_is_left_out(machine):
    def run():
        machine.processor += 10.0 if not done else 0.0
        done.append(1)
        return len(done)

    done = []
    result, found = timed(run, most=4)
    assert (result, found) == (4, Timing(1.0, 0.0))
    done.clear()
    result, found = timed(run, most=4, longest=0.5)
    assert (result, found.seconds) == (2, 6.0)
    assert timed(run, least=1, longest=0.5)[1].seconds == 1.0


def test_runs_take_turns_so_that_a_while_of_slowness_changes_the_median_of_none(machine):
    """While the second round is measured the processor is slow by half."""
    turns = []

    def run(name):
        turns.append(name)
        machine.slow = 1.5 if 2 < len(turns) <= 4 else 1.0
        return name

    found = timed_in_turn([lambda: run("a"), lambda: run("b")], least=6, most=6)
    assert turns == ["a", "b"] * 6
    assert [(result, timed.seconds) for result, timed in found] == [("a", 1.0), ("b", 1.0)]


def test_the_clock_is_the_processors_on_the_cpu_and_the_walls_where_an_accelerator_works(machine, monkeypatch):
    machine.busy = 5.0
    assert timed(lambda: None)[1].seconds == 1.0
    assert timing.cost_clock().name == "processor time"
    monkeypatch.setattr(timing, "cores", lambda: 1)
    assert timing.user_clock().name == "processor time"
    monkeypatch.setattr(timing, "cores", lambda: 2)
    assert timing.user_clock().name == "wall time"
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert timing.cost_clock().name == "wall time"
    assert timed(lambda: None)[1].seconds == 5.0


@pytest.mark.parametrize(("busy", "said"), [(1.0, ""), (2.0, "had 50% of the requested processor time")])
def test_a_user_is_told_that_the_machine_was_busy(machine, monkeypatch, busy, said):
    monkeypatch.setattr(timing, "cores", lambda: 1)
    load = Load()
    machine.busy = busy
    for _ in range(100):
        time.perf_counter()
        time.process_time()
    assert said in load.warning()
    assert bool(said) == bool(load.warning())
