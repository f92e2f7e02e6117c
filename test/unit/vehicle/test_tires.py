"""Force curves: known points, symmetry, and agreement of their different forms."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from map_racing.errors import ParameterError
from map_racing.vehicle.tires import LinearTire, PacejkaTire

TIRES = [
    PacejkaTire(3.12, 2.23, 0.72, 0.23),
    PacejkaTire(29.91, 2.23, 1.21, 0.92),
    PacejkaTire(10.0, 1.9, 1.0, -2.0),
    PacejkaTire(10.0, 1.9, 1.0, 1.0),
    PacejkaTire(4.47, 0.8, 1.0, 0.5),
    PacejkaTire(9.99, 1.5, 1.32, 1.1),
    LinearTire(4.718),
]
SLIPS = np.linspace(-1.2, 1.2, 241)

pacejka = st.builds(
    PacejkaTire,
    B=st.floats(1.0, 40.0),
    C=st.floats(0.5, 2.5),
    D=st.floats(0.3, 2.0),
    E=st.floats(-3.0, 2.0),
)


def test_magic_formula_at_a_point_worked_out_by_hand():
    # B a = 1: y = 1 - E (1 - pi/4) with E = 0.5, C = 2: sin(2 atan y) = 2 y / (1 + y^2)
    y = 1.0 - 0.5 * (1.0 - math.pi / 4.0)
    tire = PacejkaTire(B=10.0, C=2.0, D=0.9, E=0.5)
    assert tire.normalized_force(0.1) == pytest.approx(0.9 * 2.0 * y / (1.0 + y * y), abs=1e-15)


def test_linear_tire_is_proportional():
    np.testing.assert_allclose(LinearTire(5.0).normalized_force([-0.2, 0.0, 0.1]), [-1.0, 0.0, 0.5])


@pytest.mark.parametrize("tire", TIRES, ids=repr)
def test_odd_in_slip(tire):
    np.testing.assert_array_equal(tire.normalized_force(-SLIPS), -tire.normalized_force(SLIPS))


@pytest.mark.parametrize("tire", TIRES, ids=repr)
def test_scalar_form_equals_array_form(tire):
    force = tire.scalar()
    np.testing.assert_allclose(
        [force(alpha) for alpha in SLIPS.tolist()], tire.normalized_force(SLIPS), rtol=1e-14
    )


@pytest.mark.parametrize("tire", TIRES, ids=repr)
def test_slope_is_the_derivative(tire):
    h = 1e-6
    difference = (tire.normalized_force(SLIPS + h) - tire.normalized_force(SLIPS - h)) / (2.0 * h)
    np.testing.assert_allclose(tire.slope(SLIPS), difference, rtol=1e-6, atol=1e-7)
    assert tire.slope(0.0) == pytest.approx(tire.stiffness, rel=1e-15)


@settings(deadline=None)
@given(tire=pacejka)
@example(tire=PacejkaTire(1.0, 1.5, 1.0, 1.0 - 2.0**-52))
def test_peak_is_the_largest_force_on_the_first_rise(tire):
    slip = np.linspace(0.0, min(tire.peak_slip, 10.0), 1001)
    force = tire.normalized_force(slip)
    # at the limit, both sides are rounded
    assert np.all(force <= tire.peak * (1.0 + 1e-12))
    assert np.all(np.diff(force) > -1e-12)
    # as C or E approaches 1 from above, the peak moves to infinity, and its slip loses precision
    if tire.peak_slip < 3.0:
        assert tire.normalized_force(tire.peak_slip) == pytest.approx(tire.peak, rel=1e-12)
        assert tire.normalized_force(1.01 * tire.peak_slip) < tire.peak


@settings(deadline=None)
@given(tire=pacejka, share=st.floats(-0.999, 0.999))
def test_slip_inverts_the_rising_side(tire, share):
    force = share * tire.peak
    slip = tire.slip(force)
    assert tire.normalized_force(slip) == pytest.approx(force, rel=1e-9, abs=1e-12)
    assert abs(slip) <= tire.peak_slip


@pytest.mark.parametrize("tire", TIRES[:-1], ids=repr)
def test_no_slip_gives_more_than_the_peak(tire):
    assert np.all(np.isnan(tire.slip([1.001 * tire.peak, -1.001 * tire.peak, np.nan])))


def test_linear_tire_has_no_peak():
    tire = LinearTire(5.0)
    assert tire.peak == tire.peak_slip == math.inf
    assert tire.slip(1.0) == 0.2


@pytest.mark.parametrize(
    "coefficients",
    [
        (0.0, 1, 1, 0),
        (1, -1.0, 1, 0),
        (1, 1, 0, 0),
        (1, 1, 1, math.nan),
        (1, 1, "1", 0),
        (True, 1, 1, 0),
    ],
)
def test_impossible_coefficients_are_refused(coefficients):
    with pytest.raises(ParameterError, match=r"^[BCDE]: expected"):
        PacejkaTire(*coefficients)


def test_impossible_stiffness_is_refused():
    with pytest.raises(ParameterError, match="^C_S: expected a positive number, got -1"):
        LinearTire(-1.0)
