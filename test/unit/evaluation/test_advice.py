"""Advice for the next heat: limited by step, grip, error and walls; the lap comes as predicted."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from map_racing.control.controller import build_controller
from map_racing.control.parameters import load_controller_parameters
from map_racing.control.settings import parse_settings, settings_text
from map_racing.control.speed_sectors import SpeedSectors, load_speed_sectors, save_speed_sectors
from map_racing.errors import EvaluationError, ParameterError
from map_racing.evaluation.advice import _stretches, advise
from map_racing.evaluation.analysis import analyze
from map_racing.evaluation.day_grip import grip_of_day
from map_racing.evaluation.profiles import car_limits
from map_racing.evaluation.recordings import load_recording
from map_racing.evaluation.runs import evaluate
from map_racing.simulation.plant import Localization, Plant
from map_racing.simulation.plants import load_plant
from map_racing.simulation.race import Outcome, race
from map_racing.simulation.recorded import write_race_bag
from map_racing.track.raceline import Raceline
from map_racing.vehicle.parameters import load_vehicle

NUC4 = load_vehicle("nuc4")
MAP = load_controller_parameters("map").with_(grip_use=0.0)


@pytest.fixture(scope="module")
def limits():
    return car_limits(NUC4)


@pytest.fixture
def heat(driving, reference, limits):
    """``heat(scale, deviation)`` is the analysis of laps at a scale of the raceline's speeds."""

    def make(scale=0.4, deviation=lambda s: 0.0 * s, line=reference, start_s=0.0, **options):
        def speed(s):
            return scale * line.sample(s % line.length).speed

        def commands(s, v, kappa):
            pairs = zip(v.tolist(), (v**2 * kappa).tolist())
            return np.array([limits.table.steering(*pair)[0] for pair in pairs]), v

        recording = driving(line, speed, deviation, rate=50.0, commands=commands)
        return analyze(
            recording, evaluate(recording, line, start_s=start_s), limits=limits, **options
        )

    return make


def scales(advice, line):
    """Scales read back from the file at many places."""
    sectors = SpeedSectors(_stretches(advice.sectors, line), line.length)
    return np.array([sectors.scale_at(s) for s in np.arange(0.0, line.length, 0.05)])


def bump(s, at, height, reference):
    away = (s - at + 0.5 * reference.length) % reference.length - 0.5 * reference.length
    return height * np.exp(-0.5 * (away / 0.3) ** 2)


@pytest.mark.once
def test_slow_laps_may_be_driven_faster_by_the_step(heat, reference):
    advice = advise(heat(0.4), step=0.1)
    assert {one.why for one in advice.sectors} == {"step"}
    assert scales(advice, reference) == pytest.approx(0.44, abs=0.003)
    assert advice.predicted_s == pytest.approx(advice.driven_s / 1.1, rel=0.005)


def test_no_scale_is_larger_than_a_file_may_have(heat, reference):
    """On a raceline far too slow for the car, scales stop at the largest that can be loaded."""
    slow = Raceline(reference.x, reference.y, vx_mps=0.2 * reference.speed)
    advice = advise(heat(1.9, line=slow))
    assert {(one.scale, one.why) for one in advice.sectors} == {(2.0, "the largest scale")}
    assert advice.predicted_s == pytest.approx(advice.driven_s * 1.9 / 2.0, rel=0.005)


@pytest.mark.once
def test_a_command_that_the_speed_does_not_follow_is_no_base(heat, reference, limits):
    run = heat(0.4)
    commands = run.recording.commands
    other = replace(run.recording, commands=replace(commands, speed=4.0 - 0.8 * commands.speed))
    result = evaluate(other, reference)
    assert any("does not follow the speed commanded" in warning for warning in result.warnings)
    assert not result.commands_followed
    run = analyze(other, result, limits=limits)
    assert run.tracking is None
    advice = advise(run, step=0.1)
    assert all(one.driven == pytest.approx(0.4, abs=0.01) for one in advice.sectors)
    assert advice.predicted_s == pytest.approx(advice.driven_s / 1.1, rel=0.01)


def test_no_sector_is_faster_than_step_and_grip_allow(heat):
    advice = advise(heat(0.78))
    assert {"grip", "step"} <= {one.why for one in advice.sectors}
    for one in advice.sectors:
        factor = one.scale / one.driven
        assert factor <= 1.15
        if one.why == "grip":
            assert factor**2 * one.grip_used == pytest.approx(1.0, abs=0.005)


@pytest.mark.once
def test_grip_used_is_speed_squared_times_curvature_over_the_limit(heat, reference, limits):
    advice = advise(heat(0.5))
    demand = (0.5 * reference.speed) ** 2 * np.abs(reference.kappa)
    limit = advice.grip.low * limits.table.max_lateral_acceleration(6.0)
    most = max(one.grip_used for one in advice.sectors)
    assert most == pytest.approx(demand.max() / limit, rel=0.03)


@pytest.mark.once
def test_where_the_car_was_off_the_line_it_gets_no_faster(heat, reference):
    at = {}
    for height in (0.1, 0.25, 0.35):
        advice = advise(heat(0.4, lambda s, h=height: bump(s, 21.7, h, reference)))
        at[height] = {one.name: one.scale / one.driven for one in advice.sectors}
        assert at[height]["first left"] == pytest.approx(1.15, abs=0.005)
    assert at[0.1]["third left"] == pytest.approx(1.15, abs=0.005)
    assert at[0.25]["third left"] == pytest.approx(1.0, abs=0.005)
    assert at[0.35]["third left"] == pytest.approx(0.97, abs=0.005)


@pytest.mark.once
def test_a_scale_that_is_kept_does_not_shrink_from_heat_to_heat(heat):
    """It used to shrink by a thousandth if the driven scale is slightly below its rounded value."""
    sectors = advise(heat(0.4, lambda s: 0.0 * s + 0.25)).sectors
    assert all("off the line" in one.why for one in sectors) and len(sectors) > 4
    assert [one.scale for one in sectors] == [round(one.driven, 3) for one in sectors]


def test_where_the_car_was_close_to_a_wall_it_gets_no_faster(heat, reference):
    left = np.full(reference.s_points.size, 1.0)
    left[70:75] = 0.5 * NUC4.width + 0.07
    left[160:165] = 0.5 * NUC4.width - 0.02
    columns = reference.sample(reference.s_points)
    line = Raceline(
        *(columns.x, columns.y),
        vx_mps=columns.speed,
        d_left_m=left,
        d_right_m=np.full(left.size, 1.0),
    )
    advice = advise(heat(0.4, line=line))
    by_name = {one.name: one for one in advice.sectors}
    assert by_name["first right"].scale / by_name["first right"].driven == pytest.approx(
        1, abs=0.01
    )
    assert by_name["second right"].scale < by_name["second right"].driven * 0.98
    assert by_name["first right"].why.endswith("m from the wall")
    assert by_name["second right"].why.endswith("m beyond the wall")
    assert not by_name["second right"].why.startswith("-")


def test_a_faster_sector_leaves_room_to_brake(heat, reference):
    advice = advise(heat(0.75, lambda s: bump(s, 7.2, 0.35, reference)))
    found = advice.sectors
    for one, following in zip(found, found[1:] + found[:1]):
        v = reference.speed_at(reference.s_points[following.first])
        fastest, slow = one.scale * v, following.scale * v
        assert fastest**2 - slow**2 <= 2.0 * 3.0 * 1.5 + 0.05


@pytest.mark.once
@pytest.mark.parametrize("start_s", [0.0, 5.5])
def test_the_file_gives_the_controller_these_scales(heat, reference, tmp_path, start_s):
    advice = advise(heat(0.75, start_s=start_s))
    path = tmp_path / "speed_scaling.yaml"
    save_speed_sectors(path, reference, advice.scales(), ["after a heat"])
    read = load_speed_sectors(path, reference)
    places = np.arange(0.0, reference.length, 0.05)
    written = scales(advice, reference)
    assert [read.scale_at(s) for s in places] == pytest.approx(written.tolist())
    for one in advice.sectors:
        middle = one.begin + 0.5 * ((one.end - one.begin) % reference.length)
        assert read.scale_at(middle + start_s) == one.scale


def test_scales_above_1_raise_the_limit_of_the_file(tmp_path, reference):
    path = tmp_path / "speed_scaling.yaml"
    notes = ["after a.bag\nglobal_limit: 0.1"]  # a nasty name
    sectors = [(0, 99, "left", 1.2), (100, 365, "straight", 0.9)]
    save_speed_sectors(path, reference, sectors, notes)
    read = load_speed_sectors(path, reference)
    assert read.scale_at(1.0) == 1.2 and read.scale_at(20.0) == 0.9


def test_an_oval_without_corners_is_one_sector(heat, driving, limits):
    angle = 2.0 * np.pi * np.arange(200) / 200
    ring = Raceline(4.0 * np.cos(angle), 4.0 * np.sin(angle), vx_mps=np.full(200, 5.0))
    advice = advise(heat(0.5, line=ring))
    assert len(advice.sectors) == 1
    assert scales(advice, ring) == pytest.approx(0.575, abs=0.003)


# -- the controller's own limit --------------------------------------------------------------------


def told(line, scale, sectors=None, grip_use=0.0):
    """Settings of a controller that drove at a scale, or in sectors of the line's speed."""
    parameters = MAP.with_(speed_scale=1.0 if sectors else scale, grip_use=grip_use)
    text = settings_text(build_controller(parameters, NUC4, line, sectors))
    return parse_settings(text)


@pytest.mark.once
def test_what_the_controller_holds_back_is_no_advice(heat, reference):
    """Its own limit is 3 m/s everywhere: beyond that, a larger scale changes nothing."""
    ring = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    line = Raceline(6.0 * np.cos(ring), 6.0 * np.sin(ring), vx_mps=np.full(200, 5.0))
    settings = told(line, 0.58)
    settings = replace(settings, controller=settings.controller.with_(v_max_mps=3.0))
    (one,) = advise(heat(0.58, line=line, settings=settings), step=0.1).sectors
    assert one.why == "v_max_mps" and one.scale == pytest.approx(0.6, abs=0.001)
    settings = replace(settings, controller=settings.controller.with_(v_max_mps=2.9))
    (one,) = advise(heat(0.58, line=line, settings=settings), step=0.1).sectors
    assert one.why == "v_max_mps" and one.scale == one.driven == pytest.approx(0.58)
    (one,) = advise(heat(0.58, line=line, settings=told(line, 0.58)), step=0.1).sectors
    assert one.why == "step" and one.scale == pytest.approx(0.638, abs=0.001)


@pytest.mark.once
def test_where_the_slowest_place_is_held_back_the_row_says_so(heat, reference):
    advice = advise(heat(0.6, settings=told(reference, 0.6, grip_use=0.4)))
    said = {one.name: one.why for one in advice.sectors}
    assert any("grip_use" in why for why in said.values()), said
    assert any("bound by grip_use" in note for note in advice.notes)
    free = advise(heat(0.6, settings=told(reference, 0.6)))
    assert not any("grip_use" in one.why for one in free.sectors)
    assert not any("own limit" in note for note in free.notes)


@pytest.mark.once
@pytest.mark.parametrize("shift", [0.0, 0.001, -0.09, 0.1])
def test_the_scale_of_a_driven_sector_is_not_that_of_its_neighbor(heat, reference, shift):
    """The file refers to the points of the loaded line; in a bag they are at other places."""
    before = advise(heat(0.6, settings=told(reference, 0.6)))
    driven = {one.name: 0.55 if i % 2 else 0.65 for i, one in enumerate(before.sectors)}
    rows = [one._replace(scale=driven[one.name]) for one in before.sectors]
    length = reference.length
    moved = [
        ((begin + shift) % length, (end + shift) % length, scale)
        for begin, end, scale in _stretches(rows, reference)
    ]
    settings = told(reference, 1.0, SpeedSectors(moved, length))
    found = {one.name: one.driven for one in advise(heat(0.6, settings=settings)).sectors}
    assert found == {name: pytest.approx(scale) for name, scale in driven.items()}


# -- what the recording does not show --------------------------------------------------------------


def test_a_heat_that_does_not_tell_is_refused(driving, reference, heat, limits):
    recording = driving(reference, lambda s: 3.0 + 0.0 * s)
    result = evaluate(recording, reference)
    with pytest.raises(EvaluationError, match="--vehicle"):
        advise(analyze(recording, result))
    bare = Raceline(reference.x, reference.y)
    with pytest.raises(EvaluationError, match="no speeds"):
        advise(analyze(recording, evaluate(recording, bare), limits=limits))
    short = driving(reference, lambda s: 3.0 + 0.0 * s, laps=0.5)
    with pytest.raises(EvaluationError, match="no lap was completed"):
        advise(analyze(short, evaluate(short, reference), limits=limits))
    for step in (0.0, -0.1, 1.5, float("nan")):
        with pytest.raises(ParameterError, match="step"):
            advise(heat(0.4), step=step)


def test_without_commands_any_day_s_grip_is_taken(driving, reference, limits):
    recording = driving(reference, lambda s: 0.5 * reference.sample(s % reference.length).speed)
    advice = advise(analyze(recording, evaluate(recording, reference), limits=limits))
    assert advice.grip.belief is None and advice.grip.low == pytest.approx(0.82, abs=0.01)
    assert any("does not show the grip" in note for note in advice.notes)
    assert advice.predicted_s == pytest.approx(advice.driven_s / 1.15, rel=0.01)


def test_a_vehicle_file_of_another_car_is_noticed(heat):
    assert any("the file of another car" in note for note in advise(heat(1.1)).notes)


# -- in the loop -----------------------------------------------------------------------------------


def drive(line, parameters, sectors, plant_parameters, path):
    controller = build_controller(parameters, NUC4, line)
    controller.change(sectors=sectors)
    plant, noise = Plant(plant_parameters), Localization(plant_parameters, 1)
    log = race(plant, controller, line, noise, rate=40.0, laps=2)
    write_race_bag(path, log, line, settings=settings_text(controller))
    recording = load_recording(path)
    return log.outcome, recording, evaluate(recording, line), settings_text(controller)


@pytest.mark.once
@pytest.mark.parametrize("mu", [0.9, 1.1])
def test_the_next_heat_comes_as_predicted(reference, limits, tmp_path, mu):
    plant = replace(load_plant("nuc4"), mu_scale=mu)
    slow = MAP.with_(speed_scale=0.7)
    _, recording, result, text = drive(reference, slow, None, plant, tmp_path / "1.bag")
    run = analyze(recording, result, limits=limits, settings=parse_settings(text))
    grip = grip_of_day(recording, [lap for lap in result.laps if lap.valid], NUC4)
    assert grip.low < mu < grip.high
    advice = advise(run)
    sectors = SpeedSectors(_stretches(advice.sectors, reference), reference.length)
    fast = MAP.with_(speed_scale=1.0)
    outcome, _, result, _ = drive(reference, fast, sectors, plant, tmp_path / "2.bag")
    assert outcome is Outcome.COMPLETED
    assert result.summary.mean_lap_time_s == pytest.approx(advice.predicted_s, rel=0.01)


@pytest.mark.once
def test_heats_are_judged_by_a_script(monkeypatch, capsys):
    script = Path(__file__).resolve().parents[3] / "scripts" / "heats"
    words = ["--tracks", "reference", "--seeds", "9", "--laps", "1"]
    monkeypatch.setattr("sys.argv", [str(script), *words])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(script), run_name="__main__")
    text = capsys.readouterr().out
    assert ended.value.code == 0 and "3 of 3 heats completed" in text
    assert "faster than the best uniform scale" in text
