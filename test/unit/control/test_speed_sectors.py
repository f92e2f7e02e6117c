"""Speed sectors: scales by stretch, across the start line, and the public stack's files."""

import math

import numpy as np
import pytest

from map_racing.control.speed_sectors import (
    SpeedSectors,
    corners_and_straights,
    load_speed_sectors,
    save_speed_sectors,
)
from map_racing.errors import FileFormatError, ParameterError
from map_racing.track.files.load import load_raceline
from map_racing.track.raceline import Raceline

FILE = """\
global_limit: 0.9
n_sectors: 2
Sector0: {start: 0, end: 9, scaling: 0.5, only_FTG: false, no_FTG: false}
Sector1: {start: 10, end: 19, scaling: 1.0, only_FTG: false, no_FTG: false}
"""


def circle(points=20):
    angle = 2.0 * np.pi * np.arange(points) / points
    return Raceline(3.0 * np.cos(angle), 3.0 * np.sin(angle), vx_mps=np.full(points, 4.0))


def load(tmp_path, text=FILE, raceline=None):
    path = tmp_path / "speed_scaling.yaml"
    path.write_text(text)
    return load_speed_sectors(path, raceline or circle())


def test_scales_hold_from_start_to_end_and_are_1_elsewhere():
    sectors = SpeedSectors([(6.0, 8.0, 0.5), (2.0, 3.0, 0.0), (3.0, 4.0, 1.2)], 10.0)
    for s, scale in [(0.0, 1.0), (1.999, 1.0), (2.0, 0.0), (2.999, 0.0), (3.0, 1.2), (3.999, 1.2)]:
        assert sectors.scale_at(s) == scale
    for s, scale in [(4.0, 1.0), (6.0, 0.5), (7.999, 0.5), (8.0, 1.0), (9.999, 1.0)]:
        assert sectors.scale_at(s) == scale
    assert SpeedSectors([], 10.0).scale_at(3.0) == 1.0


@pytest.mark.parametrize("lap", [-2, -1, 1, 7])
def test_places_repeat_every_lap(lap):
    sectors = SpeedSectors([(2.0, 3.0, 0.5)], 10.0)
    assert sectors.scale_at(2.5 + 10.0 * lap) == 0.5
    assert sectors.scale_at(3.5 + 10.0 * lap) == 1.0


def test_a_sector_may_cross_the_start_line():
    sectors = SpeedSectors([(8.0, 1.0, 0.5), (1.0, 2.0, 0.7)], 10.0)
    for s, scale in [(7.9, 1.0), (8.0, 0.5), (9.99, 0.5), (0.0, 0.5), (0.99, 0.5), (1.0, 0.7)]:
        assert sectors.scale_at(s) == scale


def test_a_sector_of_the_whole_lap_leaves_no_hole_at_the_line():
    sectors = SpeedSectors([(0.0, 10.0, 0.5)], 10.0)
    for s in (0.0, 5.0, 9.999999999, 10.0):
        assert sectors.scale_at(s) == 0.5
    # Python's modulo of a tiny negative number is the divisor itself.
    assert -1e-17 % 10.0 == 10.0
    assert sectors.scale_at(-1e-17) == 0.5


@pytest.mark.parametrize(
    "stretches",
    [
        [(1.0, 3.0, 0.5), (2.0, 4.0, 0.6)],
        [(2.0, 4.0, 0.6), (1.0, 3.0, 0.5)],
        [(1.0, 5.0, 0.5), (2.0, 3.0, 0.6)],
        [(1.0, 3.0, 0.5), (1.0, 3.0, 0.5)],
        [(8.0, 2.0, 0.5), (1.0, 3.0, 0.6)],
        [(8.0, 2.0, 0.5), (7.0, 9.0, 0.6)],
    ],
)
def test_overlap_is_refused(stretches):
    with pytest.raises(ParameterError, match="no overlap, got one at [0-9.]+ m"):
        SpeedSectors(stretches, 10.0)


@pytest.mark.parametrize("scale", [-0.1, math.nan, math.inf, 2.01, 82.9])
def test_impossible_scales_are_refused(scale):
    """A scale in percent would be 100 times too large."""
    expected = f"expected a scale from 0 to 2, 1 for 100 %, got {scale:g}"
    with pytest.raises(ParameterError, match=f"1 to 2 m: {expected}"):
        SpeedSectors([(1.0, 2.0, scale)], 10.0)
    with pytest.raises(ParameterError, match=expected):
        SpeedSectors([], 10.0, elsewhere=scale)
    assert SpeedSectors([(1.0, 2.0, 2.0)], 10.0).scale_at(1.5) == 2.0


def test_what_the_sectors_make_of_the_speed_is_told():
    sectors = SpeedSectors([(0.0, 5.0, 0.8), (5.0, 10.0, 1.1)], 10.0)
    text = "speed sectors: 80 to 110 % of the raceline's speed"
    assert sectors.told(1.0) == text
    assert sectors.told(0.7) == (
        f"{text}, times speed_scale 0.7: 56 to 77 %; sectors of advise are for speed_scale 1"
    )
    alike = SpeedSectors([(0.0, 5.0, 0.8), (5.0, 10.0, 0.8)], 10.0)
    assert alike.told(1.0) == "speed sectors: 80 % of the raceline's speed"


@pytest.mark.parametrize("start, end", [(-1.0, 2.0), (12.0, 15.0), (8.0, 11.0), (11.0, 1.0)])
def test_places_off_the_track_are_refused(start, end):
    """They would silently have no effect."""
    with pytest.raises(ParameterError, match=r"expected different places from 0 to 10 m"):
        SpeedSectors([(start, end, 0.5)], 10.0)


def test_a_sector_without_length_is_refused():
    """Interpreted as crossing the line, it would silently scale the whole lap."""
    with pytest.raises(ParameterError, match="speed sector 5 to 5 m: expected"):
        SpeedSectors([(5.0, 5.0, 0.5)], 10.0)


def test_indices_are_those_of_the_racelines_points(tmp_path):
    raceline = circle()
    sectors = load(tmp_path, raceline=raceline)
    border = raceline.s_points[10]
    assert sectors.scale_at(0.0) == sectors.scale_at(border - 1e-6) == 0.5
    # the second sector's 1.0 is cut by the global limit, and reaches up to the line
    assert sectors.scale_at(border) == sectors.scale_at(raceline.length - 1e-6) == 0.9


@pytest.mark.parametrize("key", ["global_limt: 0.5", "Sector2: {start: 0, end: 1, scaling: 0.5}"])
def test_keys_that_would_be_ignored_are_refused(tmp_path, key):
    path = tmp_path / "speed_scaling.yaml"
    sectors = "".join(f"Sector{i}: {{start: {i}, end: {i}, scaling: 1.0}}\n" for i in (0, 1))
    path.write_text(f"n_sectors: 2\n{sectors}{key}\n")
    with pytest.raises(
        ParameterError, match=f"{key.split(':')[0]}: unknown; known are global_limit"
    ):
        load_speed_sectors(path, load_raceline("reference"))


def test_the_global_limit_holds_between_sectors_too(tmp_path):
    sectors = load(
        tmp_path, "{global_limit: 0.6, n_sectors: 1, Sector0: {start: 5, end: 9, scaling: 0.4}}"
    )
    assert sectors.scale_at(0.0) == 0.6
    raceline = circle()
    assert sectors.scale_at(raceline.s_points[6]) == 0.4
    assert sectors.scale_at(raceline.s_points[15]) == 0.6


def test_ends_beyond_the_points_mean_the_line(tmp_path):
    """Files include the closing point, which a raceline drops."""
    sectors = load(tmp_path, "{n_sectors: 1, Sector0: {start: 0, end: 20, scaling: 0.5}}")
    assert sectors.scale_at(circle().length - 1e-6) == 0.5
    for place in (20, 21):  # there is nothing left to scale
        text = f"{{n_sectors: 1, Sector0: {{start: {place}, end: {place}, scaling: 0.5}}}}"
        assert load(tmp_path, text).stretches() == [(0.0, circle().length, 1.0)]


@pytest.mark.parametrize("end, at_the_line", [(17, 1.0), (18, 1.2), (19, 1.2), (20, 1.2)])
def test_a_file_that_counts_one_point_less_reaches_the_line(tmp_path, end, at_the_line):
    """A bag has its raceline every 0.1 m, often one point more or less than the track's file."""
    text = "{global_limit: 2, n_sectors: 2, Sector0: {start: 0, end: 9, scaling: 0.8}, Sector1: "
    sectors = load(tmp_path, text + f"{{start: 10, end: {end}, scaling: 1.2}}}}")
    assert sectors.scale_at(circle().length - 1e-6) == at_the_line


@pytest.mark.parametrize("end, doubted", [(2, True), (17, True), (18, False), (20, False)])
def test_sectors_that_end_long_before_the_lap_are_doubted(tmp_path, end, doubted):
    """Sectors of a track with fewer points would scale the wrong places."""
    text = f"{{n_sectors: 1, Sector0: {{start: 0, end: {end}, scaling: 0.5}}}}"
    doubts = load(tmp_path, text).doubts
    assert len(doubts) == doubted
    if doubted:
        assert doubts[0].endswith(
            f"speed_scaling.yaml: the last sector ends at point {end}, the raceline has 20: are "
            "the sectors of another one?"
        )


def test_the_order_of_the_sectors_does_not_matter_for_the_doubt(tmp_path):
    text = "{n_sectors: 2, Sector0: {start: 10, end: 19, scaling: 1}, "
    assert load(tmp_path, text + "Sector1: {start: 0, end: 9, scaling: 0.5}}").doubts == ()


@pytest.mark.parametrize(
    "starts, said",
    [((0, 10), ""), ((0, 12), "points 10 to 11 are in no sector"), ((3, 10), "points 0 to 2 are")],
)
def test_points_before_or_between_sectors_are_doubted(tmp_path, starts, said):
    """There the car drives at the global limit."""
    one, two = starts
    text = f"{{n_sectors: 2, Sector0: {{start: {one}, end: 9, scaling: 0.5}}, "
    doubts = load(tmp_path, text + f"Sector1: {{start: {two}, end: 19, scaling: 0.8}}}}").doubts
    assert len(doubts) == bool(said) and said in "".join(doubts)


def test_no_sectors_are_no_doubt(tmp_path):
    assert load(tmp_path, "{n_sectors: 0, global_limit: 0.5}").doubts == ()


def test_real_sectors_of_another_track_are_doubted(shared_data):
    """The circle's sectors cover 227 points, the hangar's raceline has 396."""
    line = load_raceline(shared_data / "tracks" / "hangar" / "global_waypoints.json.gz")
    sectors = load_speed_sectors(shared_data / "tracks" / "circle" / "speed_scaling.yaml", line)
    assert "ends at point 227" in sectors.doubts[0]


def test_one_point_is_left_where_the_lap_is_not_covered(tmp_path):
    sectors = load(tmp_path, "{n_sectors: 1, Sector0: {start: 5, end: 18, scaling: 0.5}}")
    assert sectors.scale_at(circle().length - 1e-6) == 1.0


@pytest.mark.parametrize("track, scale", [("circle", 0.7), ("hangar", 0.5)])
def test_real_files(shared_data, track, scale):
    folder = shared_data / "tracks" / track
    raceline = load_raceline(folder / "global_waypoints.json.gz")
    sectors = load_speed_sectors(folder / "speed_scaling.yaml", raceline)
    found = {sectors.scale_at(s) for s in np.linspace(0.0, raceline.length, 1000)}
    assert found == {scale} and sectors.doubts == ()


@pytest.mark.parametrize(
    "old, new, expected",
    [
        ("n_sectors: 2", "", "not a speed_scaling.yaml: n_sectors is missing"),
        ("n_sectors: 2", "n_sectors: two", "n_sectors: expected a finite number"),
        ("n_sectors: 2", "n_sectors: true", "n_sectors: expected a finite number"),
        ("n_sectors: 2", "n_sectors: 3", "Sector2: expected start, end and scaling"),
        ("n_sectors: 2", "n_sectors: -1", "n_sectors: expected a whole number >= 0, got -1"),
        ("n_sectors: 2", "n_sectors: 1.5", "n_sectors: expected a whole number >= 0, got 1.5"),
        ("global_limit: 0.9", "global_limit: .nan", "global_limit: expected a finite number"),
        ("global_limit: 0.9", "global_limit: -1", "global_limit: expected a scale from 0 to 2"),
        ("global_limit: 0.9", "global_limit: 90", "global_limit: expected a scale from 0 to 2"),
        ("global_limit: 0.9", f"global_limit: {10**400}", "global_limit: expected a number of at"),
        ("start: 10", "begin: 10", "Sector1: start is missing"),
        ("scaling: 0.5", "scalling: 0.5", "Sector0: scaling is missing"),
        ("start: 10", "start: 9", "overlap"),
        ("start: 10", "start: 9.7", "Sector1: start: expected a whole number >= 0, got 9.7"),
        ("start: 10", "start: -1", "Sector1: start: expected a whole number >= 0, got -1"),
        ("start: 10", "start: 25", "Sector1: expected start <= end, got 25, 19"),
        (
            "start: 10, end: 19",
            "start: 40, end: 50",
            "Sector1: end: expected an index of the raceline's 20 points, got 50",
        ),
        ("scaling: 0.5", "scaling: fast", "Sector0: scaling: expected a finite number"),
        ("scaling: 0.5", "scaling: -0.5", "Sector0: scaling: expected a scale from 0 to 2"),
        ("scaling: 0.5", "scaling: 82.9", "scale from 0 to 2, 1 for 100 %, got 82.9"),
        ("Sector1:", "Sector7:", "Sector1: expected start, end and scaling"),
    ],
)
def test_malformed_files_are_refused_by_field(tmp_path, old, new, expected):
    assert old in FILE
    with pytest.raises(ParameterError) as caught:
        load(tmp_path, FILE.replace(old, new))
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "speed_scaling.yaml")) and "\n" not in message
    assert expected in message


def test_files_that_are_none_are_refused(tmp_path):
    with pytest.raises(FileFormatError, match=r"speed_scaling\.yaml: cannot read"):
        load_speed_sectors(tmp_path / "speed_scaling.yaml", circle())
    with pytest.raises(FileFormatError, match=r"expected a speed_scaling\.yaml .YAML., got a list"):
        load(tmp_path, "- 1\n")


def test_corners_and_straights_of_a_stadium(tmp_path):
    """Two half circles and two straights give four sectors, and each scale is read back in its
    sector."""
    turn = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 40)
    straight = np.linspace(-8.0, 8.0, 80)[1:-1]
    x = np.concatenate((8.0 + 3 * np.cos(turn), straight[::-1], -8.0 - 3 * np.cos(turn), straight))
    y = np.concatenate(
        (3.0 * np.sin(turn), np.full(78, 3.0), -3.0 * np.sin(turn), np.full(78, -3.0))
    )
    track = Raceline(x, y, vx_mps=np.full(x.size, 4.0))
    sectors = corners_and_straights(track)
    assert [what for _, _, what in sectors] == ["left", "straight", "left", "straight"]
    assert sectors[0][0] == 0 and sectors[-1][1] == track.s_points.size - 1
    for (_, end, _), (start, _, _) in zip(sectors, sectors[1:]):
        assert start == end + 1
    # The ends of the half circles, within a few points.
    assert sectors[1][0] == pytest.approx(40, abs=4) and sectors[2][0] == pytest.approx(118, abs=4)
    assert {what for _, _, what in corners_and_straights(track.reversed())} == {
        "right",
        "straight",
    }
    path = tmp_path / "speed_scaling.yaml"
    save_speed_sectors(path, track, sectors)
    scales = load_speed_sectors(path, track)
    assert {scales.scale_at(s) for s in track.s.tolist()} == {1.0}
    path.write_text(path.read_text().replace("scaling: 1.0", "scaling: 0.5", 1))
    scales = load_speed_sectors(path, track)
    assert scales.scale_at(track.s_points[sectors[0][1]]) == 0.5
    assert scales.scale_at(track.s_points[sectors[1][0]] + 1e-6) == 1.0


@pytest.mark.parametrize(
    ("change", "doubted"),
    [
        (lambda x, y: (x, y), False),
        (lambda x, y: (x + 0.3, y), False),  # another line on the same track
        (lambda x, y: (np.append(x, x[:1]), np.append(y, y[:1])), False),  # closing point
        (lambda x, y: (x[:-1], y[:-1]), False),  # as a bag may have it
        (lambda x, y: (x[::-1], y[::-1]), True),
        (lambda x, y: (np.roll(x, 20), np.roll(y, 20)), True),
        (lambda x, y: (x + 3.0, y), True),
        (lambda x, y: (2.0 * x, 2.0 * y), True),
        (lambda x, y: (y, x), True),
    ],
)
def test_sectors_of_another_track_with_as_many_points_are_doubted(tmp_path, change, doubted):
    angle = np.linspace(0.0, 2.0 * math.pi, 200, endpoint=False)
    x, y = 9.0 * np.cos(angle), 5.0 * np.sin(angle)
    path = tmp_path / "speed_scaling.yaml"
    track = Raceline(x, y, vx_mps=np.full(200, 4.0))
    sectors = corners_and_straights(track)
    assert len(sectors) > 2
    save_speed_sectors(path, track, sectors)
    doubts = load_speed_sectors(path, Raceline(*change(x, y))).doubts
    assert any("from where it begins on the raceline that" in said for said in doubts) == doubted
    assert bool(doubts) == doubted


@pytest.mark.parametrize("places", ["3", "[[0, 1]]", "[[0, 1], [2]]", "[[0, 1], [2, x]]", "null"])
def test_places_that_are_none_are_refused(tmp_path, places):
    text = FILE + f"start_points: {places}\n"
    if places == "null":
        assert load(tmp_path, text).doubts == ()
    else:
        with pytest.raises(ParameterError, match="start_points: "):
            load(tmp_path, text)


def test_a_file_without_sectors_has_no_places(tmp_path):
    text = "global_limit: 0.8\nn_sectors: 0\nstart_points: []\n"
    assert load(tmp_path, text).scale_at(3.0) == 0.8


def test_an_oval_has_corners_where_it_bends_most():
    """Driven at the limit all around, its lateral acceleration is the same everywhere."""
    angle = np.linspace(0.0, 2.0 * math.pi, 200, endpoint=False)
    line = Raceline(9.0 * np.cos(angle), 5.0 * np.sin(angle))
    at = line.sample(line.s_points)
    fast = Raceline(at.x, at.y, vx_mps=np.sqrt(5.0 / np.abs(at.kappa)))
    kinds = [what for _, _, what in corners_and_straights(fast)]
    assert kinds == ["left", "straight", "left", "straight", "left"]
    round_one = Raceline(5.0 * np.cos(angle), 5.0 * np.sin(angle), vx_mps=np.full(200, 5.0))
    assert [what for _, _, what in corners_and_straights(round_one)] == ["left"]


def test_sectors_need_speeds():
    angle = np.linspace(0.0, 6.0, 50)
    with pytest.raises(ParameterError, match="no speeds"):
        corners_and_straights(Raceline(np.cos(angle), np.sin(angle)))
