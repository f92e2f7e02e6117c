"""L1 guidance: the lateral acceleration that leads to a lookahead point.

The law behind both pure pursuit and MAP. On the circle that is tangent to the velocity vector and
passes through a point of the path at distance ``L_d``, a car at speed ``v`` has

    a_lat = 2 v^2 / L_d sin(eta)

with ``eta`` the angle from the velocity vector to the lookahead point (Becker et al. 2023, eq. 1,
after Park, Deyst, How, "A New Nonlinear Guidance Logic for Trajectory Tracking", AIAA 2004).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from .state import CarState

__all__ = ["LookaheadLaw", "arc_to", "bearing", "lateral_acceleration", "missing_curvature"]

# Below this speed [m/s] noise hides the direction of the velocity, and the steering of a standing
# car would swing from lock to lock.
CRAWL = 0.5


class LookaheadLaw(NamedTuple):
    """Lookahead distance ``L_d = m + q v``, clipped to [`minimum`, `maximum`].

    As in the paper, `m` is the offset [m] and `q` the gain [s]. The authors' published code swaps
    the letters (``L = q + m v``). A term that grows with the square of the speed, `growth` [s^2/m],
    is added; it is not in the paper.
    """

    m: float
    q: float
    minimum: float
    maximum: float
    growth: float = 0.0

    def distance(self, speed: float) -> float:
        """Lookahead distance [m] at a speed [m/s]."""
        distance = self.m + (self.q + self.growth * speed) * speed
        if distance < self.minimum:
            return self.minimum
        if distance > self.maximum:
            return self.maximum
        return distance


def bearing(state: CarState, x: float, y: float) -> float:
    """Angle ``eta`` from the velocity vector of a car to a point, positive to the left.

    Parameters
    ----------
    state : CarState
        A car that stands or rolls backwards counts as moving straight ahead; up to 0.5 m/s this
        direction blends into the velocity's.
    x, y : float
        Point in the map frame [m].

    Returns
    -------
    float
        Angle in [-pi, pi] [rad]; beyond +-pi/2 the point is behind the car.
    """
    # A car that rolls backwards will drive forwards, where its nose points.
    _, own_x, own_y, psi, v_x, v_y, _ = state
    if v_x < 0.0:
        v_x = 0.0
    square = v_x * v_x + v_y * v_y
    if square < CRAWL * CRAWL:
        trust = math.sqrt(square) / CRAWL
        v_x, v_y = trust * v_x + (1.0 - trust) * CRAWL, trust * v_y
    course = psi + math.atan2(v_y, v_x)
    eta = math.atan2(y - own_y, x - own_x) - course
    return math.remainder(eta, math.tau)


def lateral_acceleration(speed: float, distance: float, eta: float) -> float:
    """The L1 law, ``a_lat = 2 v^2 / L_d sin(eta)``.

    For a point behind the car (``|eta| > pi/2``) the sine would decrease again and vanish for a
    point straight behind; the largest demand is kept instead, so that the car turns round.

    Parameters
    ----------
    speed : float
        Speed of the car [m/s].
    distance : float
        Distance of the lookahead point, positive [m].
    eta : float
        Angle from the velocity vector to the lookahead point [rad].

    Returns
    -------
    float
        Lateral acceleration, positive to the left [m/s^2].
    """
    sine = math.sin(eta) if -0.5 * math.pi < eta < 0.5 * math.pi else math.copysign(1.0, eta)
    return 2.0 * speed * speed / distance * sine


def missing_curvature(x, y, d, psi, kappa, point_x, point_y):
    """Curvature that the L1 law lacks for a car that is already on the path.

    The law leads such a car along the circle that is tangent to the path and passes through the
    lookahead point, of curvature ``2 sin(eta) / L_d``. Where the path's curvature changes, the
    circle's differs from it: the car turns in early, opens early, and cuts the bend. Adding the
    difference makes the path itself a solution of the law.

    Parameters
    ----------
    x, y : float
        The car [m].
    d, psi, kappa : float
        Its lateral error [m], and the path's heading [rad] and curvature [1/m] beside it.
    point_x, point_y : float
        Lookahead point on the path [m].

    Returns
    -------
    float
        Path curvature minus circle curvature, positive to the left [1/m]; 0 where the lookahead
        point is beside the car.
    """
    dx, dy = point_x - x, point_y - y
    cosine, sine = math.cos(psi), math.sin(psi)
    # The lookahead point as seen from the car's projection, along the path and to its left.
    along, aside = cosine * dx + sine * dy, cosine * dy - sine * dx + d
    square = along * along + aside * aside
    return kappa - 2.0 * aside / square if square > 1e-6 else 0.0


def arc_to(x: float, y: float, point_x: float, point_y: float, eta: float, count: int = 20) -> list:
    """Arc of the L1 law from a car to a point, for drawing.

    It starts along the velocity vector. For a point behind the car, where the law keeps its largest
    demand, it is a half circle whose diameter is the distance to the point.

    Parameters
    ----------
    x, y, point_x, point_y : float
        Car and point [m].
    eta : float
        Angle from the velocity vector to the point, as from `bearing` [rad].
    count : int, optional
        Number of points.

    Returns
    -------
    list of (float, float)
        From the car to the end of the arc [m].
    """
    distance = math.hypot(point_x - x, point_y - y)
    course = math.atan2(point_y - y, point_x - x) - eta
    turn = min(max(eta, -0.5 * math.pi), 0.5 * math.pi)
    points = []
    for i in range(count):
        # A chord of a circle turns half as fast as the circle.
        part = i / (count - 1)
        chord = part if abs(turn) < 1e-6 else math.sin(part * turn) / math.sin(turn)
        direction = course + part * turn
        reach = distance * chord
        points.append((x + reach * math.cos(direction), y + reach * math.sin(direction)))
    return points
