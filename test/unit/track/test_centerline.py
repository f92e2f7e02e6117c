"""Centerlines from maps: drawn maps with a known track, and real maps with published lines."""

import math
import re
from functools import lru_cache

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

from map_racing.errors import FileFormatError, ParameterError, RacelineError
from map_racing.track.centerline import track_from_map
from map_racing.track.files.load import load_raceline
from map_racing.track.map_image import read_map_image
from map_racing.track.raceline import Raceline

FREE, OCCUPIED, UNKNOWN = 254, 0, 205
CELL = 0.05
HALF = 0.8  # half the width of the drawn track [m]


@lru_cache(maxsize=None)
def bean():
    angle = np.linspace(0.0, 2.0 * math.pi, 300, endpoint=False)
    radius = 5.0 + 1.2 * np.cos(3.0 * angle)
    return Raceline(radius * np.cos(angle), radius * np.sin(angle))


@lru_cache(maxsize=None)
def distances(track):
    """Distance of each cell from the track's line [m], in a 16 m square around the origin."""
    axis = (np.arange(320) + 0.5) * CELL - 8.0
    x, y = np.meshgrid(axis, axis[::-1])
    at = track.sample(np.linspace(0.0, track.length, 4000, endpoint=False))
    return cKDTree(np.stack((at.x, at.y), axis=1)).query(np.stack((x, y), axis=-1))[0]


def drawn(track=None, outside=OCCUPIED):
    """Gray values of the track's free space, first row on top."""
    distance = distances(track or bean())
    gray = np.full(distance.shape, outside, dtype=np.uint8)
    gray[distance < HALF + 2.0 * CELL] = OCCUPIED
    gray[distance < HALF] = FREE
    return gray


def cells(gray, x, y, size):
    """A square of cells around a place, to draw into."""
    column, row, half = int((x + 8.0) / CELL), int((8.0 - y) / CELL), int(round(0.5 * size / CELL))
    return gray[row - half : row + half + 1, column - half : column + half + 1]


def written(folder, gray, suffix="png", **fields):
    """Image and YAML file of a map; the path of the latter."""
    Image.fromarray(gray).save(str(folder / f"map.{suffix}"))
    content = {
        "image": f"map.{suffix}",
        "resolution": CELL,
        "origin": [-8.0, -8.0, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    content.update(fields)
    path = folder / "map.yaml"
    path.write_text(
        "".join(f"{key}: {value}\n" for key, value in content.items() if value is not None)
    )
    return path


def track_of(folder, gray, start=None, psi=None, passage=0.5, **fields):
    start = start or bean().position(0.0)
    return track_from_map(
        read_map_image(written(folder, gray, **fields)), start, psi, passage=passage
    )


def codes(track):
    return [finding.code for finding in track.findings]


def deviations(track, expected):
    return np.array([expected.project(x, y).d for x, y in zip(track.x.tolist(), track.y.tolist())])


@pytest.mark.parametrize("suffix", ["png", "pgm", "bmp"])
def test_line_and_widths_of_a_drawn_track(tmp_path, suffix):
    track = track_of(tmp_path, drawn(), suffix=suffix)
    assert np.abs(deviations(track, bean())).max() < 0.05
    assert track.length == pytest.approx(bean().length, rel=0.01)
    total = track.d_left + track.d_right
    assert np.median(total) == pytest.approx(2.0 * HALF, abs=CELL)
    assert total.min() > 2.0 * HALF - 2.0 * CELL and total.max() < 2.0 * HALF + 3.0 * CELL
    # The direction is not given, and the lap begins beside the start.
    assert codes(track) == ["direction"]
    assert np.hypot(track.x[0] - 6.2, track.y[0]) < 0.1
    assert np.sum(track.kappa) * track.ds == pytest.approx(2.0 * math.pi, abs=0.01)


@pytest.mark.parametrize("psi, turn", [(0.5 * math.pi, 1.0), (-0.5 * math.pi, -1.0)])
def test_direction_of_travel(tmp_path, psi, turn):
    track = track_of(tmp_path, drawn(), psi=psi)
    assert math.cos(track.psi[0] - psi) > 0.99
    assert np.sum(track.kappa) * track.ds == pytest.approx(turn * 2.0 * math.pi, abs=0.01)
    assert codes(track) == []


def test_a_direction_across_the_track_is_refused(tmp_path):
    with pytest.raises(
        ParameterError, match="expected a direction within 75 degrees .* got 0.00 rad"
    ):
        track_of(tmp_path, drawn(), psi=0.0)


def test_origin_with_yaw(tmp_path):
    """The map rotated about its lower left corner, and moved."""
    yaw, moved = 0.7, np.array([3.0, -2.0])
    rotation = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])

    def world(points):
        return (np.asarray(points) + 8.0).dot(rotation.T) + moved

    track = track_of(
        tmp_path, drawn(), start=tuple(world(bean().position(0.0))), origin=[3.0, -2.0, yaw]
    )
    expected = Raceline(*world(np.stack((bean().x, bean().y), axis=1)).T)
    assert np.abs(deviations(track, expected)).max() < 0.05


def test_negated_map(tmp_path):
    track = track_of(tmp_path, 255 - drawn(), negate=1)
    assert np.abs(deviations(track, bean())).max() < 0.05


def test_color_and_transparent_images(tmp_path):
    gray = drawn()
    colored = np.stack([gray] * 3 + [np.full_like(gray, 255)], axis=-1)
    track = track_of(tmp_path, colored)
    assert np.abs(deviations(track, bean())).max() < 0.05


@pytest.mark.parametrize("mode", ["RGBA", "LA"])
def test_what_was_erased_from_an_image_is_unknown(tmp_path, mode):
    """Editors keep some color below what is transparent, such as white."""
    gray = drawn(outside=UNKNOWN)
    erased = (gray == UNKNOWN) | (np.arange(gray.size).reshape(gray.shape) < 320)
    image = Image.fromarray(np.where(erased, 255, gray).astype(np.uint8)).convert(mode)
    image.putalpha(Image.fromarray(np.where(erased, 0, 255).astype(np.uint8)))
    path = written(tmp_path, gray)
    expected = read_map_image(path).free
    image.save(str(tmp_path / "map.png"))
    found = read_map_image(path)
    assert np.array_equal(found.free, expected)
    (finding,) = found.findings
    assert finding.text == f"{np.count_nonzero(erased)} transparent pixels: taken as unknown"
    image.putalpha(Image.fromarray(np.zeros_like(gray)))
    image.save(str(tmp_path / "map.png"))
    with pytest.raises(FileFormatError, match="expected free cells, all of them are transparent"):
        read_map_image(path)


def test_a_yaw_in_degrees_is_refused(tmp_path):
    path = written(tmp_path, drawn(), origin=[-8.0, -8.0, 90])
    with pytest.raises(FileFormatError, match="origin: expected a yaw in rad, got 90: in deg?"):
        read_map_image(path)


def test_16_bits_are_those_of_8(tmp_path):
    gray = drawn(outside=UNKNOWN)
    expected = read_map_image(written(tmp_path, gray)).free
    deep = read_map_image(written(tmp_path, gray.astype(np.uint16) * 257))
    assert np.array_equal(deep.free, expected)
    with pytest.raises(FileFormatError, match="8 or 16 bits"):
        read_map_image(written(tmp_path, gray.astype(np.float32) / 255.0, "tif"))


def test_a_threshold_that_is_missing_is_said(tmp_path):
    path = written(tmp_path, drawn(outside=UNKNOWN))
    path.write_text(path.read_text().replace("free_thresh", "free_tresh"))
    (finding,) = read_map_image(path).findings
    assert finding.text == "free_thresh is missing: 0.196 assumed"


def test_thin_walls_in_the_open_are_enough(tmp_path):
    track = track_of(tmp_path, drawn(outside=FREE))
    assert np.abs(deviations(track, bean())).max() < 0.05


def test_unknown_cells_are_no_road(tmp_path):
    gray = drawn(outside=UNKNOWN)
    track = track_of(tmp_path, gray)
    assert np.abs(deviations(track, bean())).max() < 0.05
    assert "unknown-cells" not in codes(track)
    # With this threshold, map_server considers them free.
    track = track_of(tmp_path, gray, free_thresh=0.25)
    assert np.abs(deviations(track, bean())).max() < 0.05
    assert "unknown-cells" in codes(track)


@pytest.mark.parametrize("painted", [0, 1, 200])
def test_unknown_cells_are_no_road_in_a_map_that_was_painted_in(tmp_path, painted):
    gray = drawn(outside=UNKNOWN)
    gray.flat[:painted] = 100
    image = read_map_image(written(tmp_path, gray, free_thresh=0.25))
    assert not image.free[::-1][gray == UNKNOWN].any() and image.free[::-1][gray == FREE].all()
    assert codes(image) == ["unknown-cells"]
    inverted = read_map_image(written(tmp_path, 255 - gray, free_thresh=0.25, negate=1))
    assert np.array_equal(inverted.free, image.free) and codes(inverted) == codes(image)
    # If all grays are equally common, 205 is just one of them.
    gray.flat[: 256 * 200] = np.arange(256 * 200) % 256
    gray[gray == UNKNOWN] = 206
    gray.flat[205 : 256 * 200 : 256] = 205
    image = read_map_image(written(tmp_path, gray, free_thresh=0.25))
    assert image.free[::-1][gray == 205].all() and "unknown-cells" not in codes(image)


def test_occupied_below_free_threshold_is_that_of_map_server(tmp_path):
    """Cells darker than the occupied threshold are occupied, whatever the free threshold."""
    gray = drawn()
    gray[:4] = [[240], [239], [200], [192]]  # 0.059, 0.063, 0.216 and 0.247 occupied
    image = read_map_image(written(tmp_path, gray, occupied_thresh=0.0625, free_thresh=0.25))
    free = image.free[::-1]
    assert free[0].all() and not free[1:4].any()
    assert codes(image) == ["thresholds"]


def test_a_yaw_that_is_applied_is_said(tmp_path):
    assert codes(read_map_image(written(tmp_path, drawn(), origin=[0.0, 0.0, 0.3]))) == [
        "origin-yaw"
    ]
    assert codes(read_map_image(written(tmp_path, drawn(), origin=[0.0, 0.0, 0.0]))) == []


def test_speckle_is_removed_and_counted(tmp_path):
    gray = drawn()
    generator = np.random.default_rng(3)
    rows, columns = np.nonzero(gray == FREE)
    for k in generator.choice(rows.size, 60, replace=False):
        gray[rows[k], columns[k]] = OCCUPIED
    track = track_of(tmp_path, gray)
    assert np.abs(deviations(track, bean())).max() < 0.08
    told = [finding for finding in track.findings if finding.code == "speckle"]
    assert len(told) == 1 and 20 < int(str(told[0]).split()[0]) <= 60


def test_a_gap_narrower_than_the_passage_is_closed(tmp_path):
    gray = drawn(outside=FREE)
    x, y = bean().to_cartesian(10.0, -HALF - CELL)
    cells(gray, float(x), float(y), 0.3)[:] = FREE
    track = track_of(tmp_path, gray)
    assert np.abs(deviations(track, bean())).max() < 0.1
    assert track.d_right.max() < HALF + 0.3


def test_a_wide_gap_in_the_outer_wall_makes_two_ways(tmp_path):
    gray = drawn(outside=FREE)
    x, y = bean().to_cartesian(10.0, -HALF - CELL)
    cells(gray, float(x), float(y), 1.0)[:] = FREE
    with pytest.raises(RacelineError, match="2 ways around islands .* black line"):
        track_of(tmp_path, gray)
    # A wider passage closes it.
    track = track_of(tmp_path, gray, passage=1.2)
    assert np.abs(deviations(track, bean())).max() < 0.15


def test_a_wide_gap_in_the_inner_wall_is_closed_and_told(tmp_path):
    gray = drawn(outside=FREE)
    x, y = bean().to_cartesian(10.0, HALF + CELL)
    cells(gray, float(x), float(y), 0.8)[:] = FREE
    track = track_of(tmp_path, gray)
    assert "openings" in codes(track)
    assert np.abs(deviations(track, bean())).max() < 0.35
    assert track.d_left.max() < HALF + 0.5


def test_a_gap_at_the_start_line_is_one_gap(tmp_path):
    gray = drawn(outside=FREE)
    x, y = bean().to_cartesian(10.0, HALF + CELL)
    cells(gray, float(x), float(y), 0.8)[:] = FREE
    for s in (9.5, 10.0, 10.1):
        track = track_of(tmp_path, gray, bean().position(s), float(bean().pose(s).psi))
        (text,) = [str(found) for found in track.findings if found.code == "openings"]
        assert text.startswith("1 opening in the walls, shorter")
        assert track.d_left.max() < HALF + 0.5


def test_an_obstacle_is_closed_toward_the_nearer_wall(tmp_path):
    gray = drawn()
    x, y = bean().to_cartesian(10.0, 0.1)
    cells(gray, float(x), float(y), 0.2)[:] = OCCUPIED
    track = track_of(tmp_path, gray)
    told = [finding for finding in track.findings if finding.code == "obstacle"]
    assert len(told) == 1 and "inner wall" in str(told[0])
    foot = track.project(float(x), float(y))
    assert foot.d > 0.3 and track.widths_at(foot.s)[0] < foot.d - 0.05


def test_several_loops_are_refused(tmp_path):
    """A hall with two blocks in it."""
    gray = np.full((320, 320), OCCUPIED, dtype=np.uint8)
    gray[40:280, 40:280] = FREE
    gray[100:220, 80:130] = gray[100:220, 190:240] = OCCUPIED
    with pytest.raises(RacelineError, match=r"expected one loop, got 2 ways around"):
        track_of(tmp_path, gray, start=(0.0, 5.0))


def room(narrow=0):
    """A room 8 m by 6 m with a block in it, 1.5 m from the walls, and a pillar beside the block."""
    gray = np.full((320, 320), OCCUPIED, dtype=np.uint8)
    gray[100:220, 80:240] = FREE
    gray[130:190, 110:210] = OCCUPIED
    gray[150:160, 210 : 210 + narrow] = OCCUPIED
    return gray


def test_corners_of_a_room_are_no_openings(tmp_path):
    track = track_of(tmp_path, room(), start=(0.0, -2.3), passage=0.4)
    assert "openings" not in codes(track)
    # The line goes around the corners, which are farther away than the walls.
    assert max(track.d_left.max(), track.d_right.max()) > 1.0


@pytest.mark.parametrize("narrow", [18, 22])
def test_a_track_that_the_passage_itself_closes_is_told(tmp_path, narrow):
    width = (30 - narrow) * CELL
    with pytest.raises(RacelineError, match=r"closes the track itself.*--passage") as error:
        track_of(tmp_path, room(narrow), start=(0.0, -2.3), passage=0.7)
    wide, x, y = (
        float(n)
        for n in re.findall(r"is ([\d.]+) m wide near \(([-\d.]+), ([-\d.]+)\)", str(error.value))[
            0
        ]
    )
    assert wide == pytest.approx(width, abs=1.1 * CELL)
    assert x == pytest.approx(3.4, abs=0.5) and abs(y) < 1.0
    passage = float(re.search(r"--passage ([\d.]+)", str(error.value)).group(1))
    assert track_of(tmp_path, room(narrow), start=(0.0, -2.3), passage=passage).length > 15.0


@pytest.mark.parametrize("walls, told", [(1, False), (0, True), (-4, True)])
def test_a_track_that_reaches_the_edge_of_the_map_is_told(tmp_path, walls, told):
    """Cropped at its walls, between them and the track, and within the track."""
    gray = drawn()
    free = np.flatnonzero(np.any(gray == FREE, axis=0))[-1]
    track = track_of(tmp_path, gray[:, : free + 1 + walls])
    assert ("edge" in codes(track)) == told


def test_no_loop_is_refused(tmp_path):
    gray = np.full((320, 320), OCCUPIED, dtype=np.uint8)
    gray[100:220, 80:240] = FREE
    with pytest.raises(RacelineError, match="has no wall inside"):
        track_of(tmp_path, gray, start=(0.0, 0.0))


@pytest.mark.parametrize(
    "start, reason",
    [
        ((0.0, 0.0), "in a wall or on unknown ground"),
        ((100.0, 0.0), "not on the map"),
        ((6.9, 0.0), r"0\.[01]. m from a wall, less than 0.25 m"),
    ],
)
def test_a_start_off_the_track_is_refused_and_a_better_one_named(tmp_path, start, reason):
    with pytest.raises(ParameterError, match=reason + "; the nearest place") as error:
        track_of(tmp_path, drawn(), start=start)
    place = str(error.value).split("(")[-1].rstrip(")").split(",")
    assert track_of(tmp_path, drawn(), start=tuple(map(float, place))).length > 30.0


def test_no_place_is_wide_enough(tmp_path):
    with pytest.raises(ParameterError, match="no place on the map is 5.00 m wide"):
        track_of(tmp_path, drawn(), passage=5.0)


@pytest.mark.parametrize(
    "fields, text",
    [
        ({"image": "none.png"}, "none.png: expected an image: No such file"),
        ({"image": "map.yaml"}, "map.yaml: expected an image"),
        ({"image": None}, "image: expected the name of a file"),
        ({"resolution": 0.0}, "resolution: expected meters per cell"),
        ({"resolution": None}, "resolution: expected a number"),
        ({"resolution": 10**400}, "resolution: expected a number"),
        ({"origin": "[0, 0]"}, "origin: expected"),
        ({"origin": "[0, 0, .nan]"}, "origin: expected a number"),
        ({"negate": 2}, "negate: expected 0 or 1"),
        ({"mode": "raw"}, "mode: expected trinary or scale"),
        ({"free_thresh": 1.9}, "free_thresh: expected 0 to 1, got 1.9"),
        ({"occupied_thresh": -0.1}, "occupied_thresh: expected 0 to 1, got -0.1"),
    ],
)
def test_what_is_wrong_in_the_files_is_named(tmp_path, fields, text):
    path = written(tmp_path, drawn(), **fields)
    with pytest.raises(FileFormatError, match=text):
        read_map_image(path)


@pytest.mark.once
@pytest.mark.parametrize("circuit", ["Spielberg", "Oschersleben"])
def test_published_centerlines_are_found_in_their_maps(shared_data, circuit):
    folder = shared_data / "tracks" / circuit
    published = load_raceline(folder / f"{circuit}_centerline.csv")
    image = read_map_image(folder / f"{circuit}_map.yaml")
    psi = float(published.psi[0])
    track = track_from_map(image, published.position(0.0), psi, passage=0.5)
    off = deviations(track, published)
    assert np.sqrt(np.mean(off**2)) < 0.02
    assert track.length == pytest.approx(published.length, rel=2e-3)
    # The files say 2.2 m everywhere; the images are up to 0.3 m narrower.
    total = track.d_left + track.d_right
    assert total.min() > 1.85 and total.max() < 2.5


def test_a_real_hall(shared_data):
    """There are posts on the track, and unknown cells look free with the file's threshold."""
    folder = shared_data / "laps" / "ipz20"
    published = load_raceline(folder / "centerline.csv")
    image = read_map_image(folder / "IPZ20.yaml")
    track = track_from_map(image, published.position(0.0), float(published.psi[0]), passage=0.5)
    assert {"unknown-cells", "obstacle"} <= set(codes(track))
    # The published line passes one of the posts on the other side.
    assert np.median(np.abs(deviations(track, published))) < 0.1


def test_a_hall_with_crossed_thresholds(shared_data):
    """Its occupied threshold is below the free one; its line was made without the map's yaw."""
    folder = shared_data / "tracks" / "hall_0822"
    image = read_map_image(folder / "hall_0822.yaml")
    assert codes(image) == ["thresholds", "origin-yaw"]
    line = load_raceline(f"{folder}/global_waypoints.json.gz#centerline_waypoints")
    start, psi = line.position(0.0), float(line.psi[0])
    with pytest.raises(ParameterError, match="Without the yaw of the map's origin, -0.46"):
        track_from_map(image, start, psi, passage=0.5)
    image = image._replace(origin=(*image.origin[:2], 0.0))
    track = track_from_map(image, start, psi, passage=0.5)
    assert np.median(np.abs(deviations(track, line))) < 0.05
    assert "openings" not in codes(track)
    with pytest.raises(RacelineError, match="--passage 0.65"):
        track_from_map(image, start, psi, passage=0.8)


def test_the_shared_case_of_unknown_cells(shared_cases):
    image = read_map_image(shared_cases / "map_gap_ft025.yaml")
    assert codes(image) == ["unknown-cells"]


def test_a_map_without_walls(shared_data):
    image = read_map_image(shared_data / "tracks" / "circle" / "circle.yaml")
    with pytest.raises(RacelineError, match="has no wall inside"):
        track_from_map(image, (0.0, 0.0), passage=0.5)
