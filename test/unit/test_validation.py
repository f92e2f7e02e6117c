"""Parameters with meaning, unit and range in one place: checks, docstrings and tables."""

import math
from dataclasses import dataclass, fields

import pytest

from map_racing.errors import ParameterError
from map_racing.validation import (
    POSITIVE,
    check,
    documented,
    meaning,
    parameter,
    parameter_table,
    read_parameters,
)


@documented
@dataclass(frozen=True)
class Pump:
    """A pump."""

    kind: str = parameter("How it pumps", choices=("piston", "gear"))
    maker: str = parameter("Who made it")
    pressure_pa: float = parameter("Largest pressure. Less is quieter", "Pa", low=POSITIVE)
    delay_s: float = parameter("Dead time", "s", low=0.0, high=1.0, default=0.1)
    slip: float = parameter("Slip", low=POSITIVE, high=0.5, default=0.2)
    offset_m: float = parameter("Height", "m", default=0.0)
    stages: int = parameter("Stages", low=1, high=3, default=1)
    seed: int = parameter("Seed", low=0, default=0)
    primed: bool = parameter("Whether it is filled", default=True)
    extra: tuple = parameter("Whatever else", default=())

    def __post_init__(self):
        check(self)


GOOD = {"kind": "gear", "maker": "me", "pressure_pa": 3}


def test_numbers_become_floats_and_the_rest_stays():
    pump = Pump(**GOOD, extra=[1])
    assert type(pump.pressure_pa) is float and type(pump.stages) is int
    assert pump.extra == [1]


@pytest.mark.parametrize(
    "changes, text",
    [
        ({"kind": "Gear"}, "kind: expected piston or gear, got 'Gear'"),
        ({"kind": ["gear"]}, r"kind: expected piston or gear, got \['gear'\]"),
        ({"maker": ""}, "maker: expected a text, got ''"),
        ({"maker": 3}, "maker: expected a text, got 3"),
        ({"maker": "a\nb"}, r"maker: expected a text, got 'a\\nb'"),
        ({"pressure_pa": 0}, "pressure_pa: expected a positive number, got 0"),
        ({"pressure_pa": math.inf}, "pressure_pa: expected a finite number, got inf"),
        ({"pressure_pa": True}, "pressure_pa: expected a finite number, got True"),
        ({"delay_s": 50.0}, "delay_s: expected 0 to 1 s, got 50"),
        ({"delay_s": -1e-9}, "delay_s: expected 0 to 1 s, got -1e-09"),
        ({"slip": 0.0}, "slip: expected more than 0 to 0.5, got 0"),
        ({"offset_m": 1e10}, "offset_m: expected a number of at most 1e.09"),
        ({"stages": 2.0}, "stages: expected 1 to 3, got 2.0"),
        ({"stages": True}, "stages: expected 1 to 3, got True"),
        ({"stages": 4}, "stages: expected 1 to 3, got 4"),
        ({"seed": -1}, "seed: expected 0 or more, got -1"),
        ({"primed": 1}, "primed: expected true or false, got 1"),
    ],
)
def test_impossible_values_are_named_with_what_was_expected(tmp_path, changes, text):
    with pytest.raises(ParameterError, match=f"^{text}"):
        Pump(**{**GOOD, **changes})
    with pytest.raises(ParameterError, match=f"^pump.yaml: {text}"):
        read_parameters("pump.yaml", Pump, {**GOOD, **changes})


def test_the_bounds_are_valid():
    for delay in (0.0, 1.0):
        assert Pump(**GOOD, delay_s=delay).delay_s == delay


def test_the_docstring_has_the_fields():
    assert Pump.__doc__.startswith("A pump.\n\nParameters\n----------\n")
    assert '\nkind : {"piston", "gear"}\n    How it pumps.\n' in Pump.__doc__
    assert "\npressure_pa : float\n    Largest pressure [Pa]. Less is quieter.\n" in Pump.__doc__
    assert "\ndelay_s : float, default 0.1\n    Dead time [s].\n" in Pump.__doc__


def test_the_table_has_the_fields():
    table = parameter_table(Pump, "~").splitlines()
    assert len(table) == 2 + len(fields(Pump))
    assert table[4] == (
        "| `~pressure_pa` |  | a positive number | Largest pressure [Pa]. Less is quieter |"
    )
    assert table[5] == "| `~delay_s` | `0.1` | 0 to 1 s | Dead time [s] |"
    assert table[9] == "| `~seed` | `0` | 0 or more | Seed |"


def test_a_log_has_the_meaning_without_the_advice():
    assert meaning(fields(Pump)[2]) == "Largest pressure [Pa]"
