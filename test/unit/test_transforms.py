"""Transforms between frames: chains, several parents, missing times."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.transforms import TransformTree

MS = 10**6


def car():
    """The car drives along x in odom, which is rotated in map; it carries a laser."""
    tree = TransformTree()
    for k in range(5):
        tree.add("odom", "base_link", 100 * MS * k, (1.0 * k, 0.0, 0.0))
    for k in range(4):
        tree.add("map", "odom", 100 * MS * k, (0.0, 5.0, 0.5 * math.pi))
    tree.add("base_link", "laser", 0, (0.3, 0.0, 0.0), static=True)
    return tree


def test_the_latest_time_that_all_of_a_chain_have():
    stamp, *pose = car().lookup("map", "base_link")
    assert stamp == 300 * MS
    assert pose == pytest.approx([0.0, 8.0, 0.5 * math.pi])
    stamp, *pose = car().lookup("map", "laser")
    assert stamp == 300 * MS
    assert pose == pytest.approx([0.0, 8.3, 0.5 * math.pi])


def test_between_two_transforms():
    assert car().lookup("odom", "base_link", 150 * MS) == (150 * MS, 1.5, 0.0, 0.0)


def test_headings_are_interpolated_the_short_way():
    tree = TransformTree()
    tree.add("map", "base_link", 0, (0.0, 0.0, math.pi - 0.1))
    tree.add("map", "base_link", 100, (0.0, 0.0, -math.pi + 0.1))
    assert abs(tree.lookup("map", "base_link", 50)[3]) == pytest.approx(math.pi)


@pytest.mark.parametrize("stamp", [-1, 401 * MS])
def test_nothing_is_extrapolated(stamp):
    assert car().lookup("odom", "base_link", stamp) is None


def test_unknown_frames_and_circles_have_no_pose():
    assert car().lookup("map", "camera") is None
    circle = TransformTree()
    circle.add("a", "b", 0, (0.0, 0.0, 0.0))
    circle.add("b", "a", 0, (0.0, 0.0, 0.0))
    assert circle.lookup("map", "a") is None


@pytest.mark.parametrize("first", [True, False])
def test_frames_without_end_hide_no_way_and_cost_no_search(monkeypatch, first):
    """Perception invents a frame for each object, beside the car's path to the map."""
    tree, searches = car() if first else TransformTree(), []
    if first:
        assert tree.lookup("map", "base_link")
    search = TransformTree._search
    monkeypatch.setattr(
        TransformTree, "_search", lambda *ends: searches.append(ends) or search(*ends)
    )
    for k in range(3000):
        tree.add("base_link", f"seen_{k}", 0, (1.0, 0.0, 0.0))
    if first:
        assert tree.lookup("map", "base_link")[0] == 300 * MS
    else:
        for parent, child in (("odom", "base_link"), ("map", "odom")):
            assert tree.lookup("map", "base_link") is None
            tree.add(parent, child, 0, (1.0, 0.0, 0.0))
        assert tree.lookup("map", "base_link") == (0, 2.0, 0.0, 0.0)
    assert len(searches) == (0 if first else 2)
    assert tree.lookup("map", "seen_2999")[0] == 0


def test_static_frames_alone():
    static = TransformTree()
    static.add("base_link", "laser", 7, (0.3, 0.0, 0.0), static=True)
    assert static.lookup("base_link", "laser") == (0, 0.3, 0.0, 0.0)


def test_history_ends_after_seconds_and_with_a_clock_set_back():
    tree = TransformTree(5000 * MS)
    for second in range(20):
        tree.add("map", "base_link", second * 1000 * MS, (float(second), 0.0, 0.0))
    assert tree.lookup("map", "base_link", 13_000 * MS) is None
    assert tree.lookup("map", "base_link", 14_500 * MS)[1] == 14.5
    tree.add("map", "base_link", 18_000 * MS, (7.0, 0.0, 0.0))
    assert tree.lookup("map", "base_link") == (18_000 * MS, 7.0, 0.0, 0.0)
    assert tree.lookup("map", "base_link", 17_500 * MS) is None


def test_transforms_may_come_in_any_order_within_half_a_second():
    tree = TransformTree()
    for ms in (0, 300, 100, 200):
        tree.add("map", "base_link", ms * MS, (0.01 * ms, 0.0, 0.0))
    assert tree.lookup("map", "base_link") == (300 * MS, 3.0, 0.0, 0.0)
    assert tree.lookup("map", "base_link", 150 * MS)[1] == pytest.approx(1.5)


def test_the_way_back_is_the_inverse():
    forth, back = car().lookup("map", "laser", 150 * MS), car().lookup("laser", "map", 150 * MS)
    (_, x, y, psi), (_, x_2, y_2, psi_2) = forth, back
    assert psi_2 == pytest.approx(-psi)
    assert x_2 == pytest.approx(-math.cos(psi) * x - math.sin(psi) * y)
    assert y_2 == pytest.approx(math.sin(psi) * x - math.cos(psi) * y)


def test_a_particle_filter_that_places_the_laser_places_the_car():
    """``map`` to ``laser`` beside the static mount of the laser: two parents of one frame."""
    tree = TransformTree()
    tree.add("base_link", "laser", 0, (0.3, 0.0, 0.0), static=True)
    tree.add("map", "laser", 5, (1.0, 2.0, 0.5 * math.pi))
    assert tree.lookup("map", "base_link") == pytest.approx((5, 1.0, 1.7, 0.5 * math.pi))


def test_a_second_parent_that_leads_nowhere_changes_nothing():
    tree = TransformTree()
    for k in range(10):
        tree.add("map", "base_link", 100 * MS * k, (float(k), 0.0, 0.0))
        tree.add("odom", "base_link", 100 * MS * k + 1, (-7.0, 0.0, 0.0))
    assert tree.lookup("map", "base_link") == (900 * MS, 9.0, 0.0, 0.0)
    assert tree.lookup("map", "base_link", 450 * MS)[1] == pytest.approx(4.5)
    assert len(tree.history("map", "base_link")[0]) == 10


def test_parents_one_after_another_make_one_history():
    tree = TransformTree()
    for k in range(20):
        if k < 10:
            tree.add("odom", "base_link", 100 * MS * k, (float(k), 0.0, 0.0))
            tree.add("map", "odom", 100 * MS * k, (0.0, 1.0, 0.0))
        else:
            tree.add("map", "base_link", 100 * MS * k, (float(k), 1.0, 0.0))
    times, poses, used = tree.history("map", "base_link")
    assert [time // MS for time in times] == [100 * k for k in range(20)]
    assert poses == [(float(k), 1.0, 0.0) for k in range(20)]
    assert len(used) == 2


def test_a_localization_that_dies_ends_the_history():
    tree = TransformTree()
    for k in range(100):
        tree.add("odom", "base_link", 25 * MS * k, (0.1 * k, 0.0, 0.0))
        if k <= 40 and k % 4 == 0:
            tree.add("map", "odom", 25 * MS * k, (0.0, 0.0, 0.0))
    assert tree.history("map", "base_link")[0][-1] == 1000 * MS
    assert tree.lookup("map", "base_link")[0] == 1000 * MS


def test_times_without_transforms_are_not_bridged():
    """Odometry is missing for 0.6 s while the localization continues."""
    tree = TransformTree()
    for k in range(200):
        if not 80 < k < 104:
            tree.add("odom", "base_link", 25 * MS * k, (0.1 * k, 0.0, 0.0))
    for k in range(250):
        tree.add("map", "odom", 20 * MS * k, (0.0, 0.0, 0.0))
    times = tree.history("map", "base_link")[0]
    assert max(b - a for a, b in zip(times, times[1:])) == 600 * MS
    assert tree.lookup("map", "base_link", 2300 * MS) is None


def test_a_slow_localization_is_no_gap():
    tree = TransformTree()
    for k in range(200):
        tree.add("odom", "base_link", 25 * MS * k, (0.1 * k, 0.0, 0.0))
    for k in range(5):
        tree.add("map", "odom", 1000 * MS * k, (0.0, 0.0, 0.0))
    assert len(tree.history("map", "base_link")[0]) == 161


@pytest.mark.parametrize("static_first", [True, False])
def test_a_static_transform_does_not_replace_a_localization(static_first):
    tree = TransformTree()
    for static in (static_first, not static_first):
        tree.add("map", "odom", 100, (0.0, 0.0, 0.0) if static else (1.0, 2.0, 0.0), static)
    tree.add("odom", "base_link", 100, (1.0, 0.0, 0.0))
    assert tree.lookup("map", "base_link") == (100, 2.0, 2.0, 0.0)


COORDINATE = st.floats(-10.0, 10.0)
POSE = st.tuples(COORDINATE, COORDINATE, st.floats(-3.0, 3.0))


@settings(deadline=None)
@given(st.lists(POSE, min_size=1, max_size=6), st.lists(st.booleans(), min_size=6, max_size=6))
def test_a_chain_is_the_product_of_its_links_whichever_way_they_point(poses, turned):
    """As complex numbers: z -> p + z exp(i psi)."""
    tree, place, turn = TransformTree(), 0j, 1 + 0j
    for k, (pose, inverse) in enumerate(zip(poses, turned)):
        at, rotation = complex(*pose[:2]), complex(math.cos(pose[2]), math.sin(pose[2]))
        if inverse:
            back = -at / rotation
            tree.add(str(k + 1), str(k), 0, (back.real, back.imag, -pose[2]))
        else:
            tree.add(str(k), str(k + 1), 0, pose)
        place, turn = place + turn * at, turn * rotation
    _, x, y, psi = tree.lookup("0", str(len(poses)))
    assert complex(x, y) == pytest.approx(place, abs=1e-9)
    assert complex(math.cos(psi), math.sin(psi)) == pytest.approx(turn, abs=1e-9)
