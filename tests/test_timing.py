"""The clock, the median and the spread behind every table and chart of times, under clocks that are made up."""

import time

import jax
import pytest

from midlie_jax.advice import timing
from midlie_jax.advice.timing import Load, Stopwatch, Timing, timed, timed_in_turn


class Machine:
    """Two clocks that go on by one at every reading; the wall's by `busy` times as much, both by `slow` times."""

    busy = slow = 1.0
    wall = processor = 0.0

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


def test_a_timing_is_the_median_of_alternate_runs_and_half_the_middle_half(machine):
    """While the second round is measured the processor is slow by half."""
    watch, turns = Stopwatch(), []
    watch.laps = [10.0, 1.0, 2.0, 3.0, 4.0]
    assert watch.timing() == Timing(3.0, pytest.approx((4 - 2) / 2 / 3))

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
    for cores, clock in ((1, "processor time"), (2, "wall time")):
        monkeypatch.setattr(timing, "cores", lambda cores=cores: cores)
        assert timing.user_clock().name == clock
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
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
