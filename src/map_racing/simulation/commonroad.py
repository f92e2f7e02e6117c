"""Plants with the CommonRoad vehicle models, a third-party package.

The package ``commonroad-vehicle-models`` (BSD) has the equations and the parameters of passenger
cars: the multi-body model (29 states: a sprung body and two axles on springs and dampers, four
wheels with rotation, PAC2002 tires with combined slip and camber) and the single-track drift model
(9 states: the same tires on two axles, with load transfer and rotating wheels). Althoff and
Würsching, "CommonRoad: Vehicle Models", 2020.

The inputs of both are the steering rate and the acceleration; servo and drive are those of the
other plants. The equations are integrated by the midpoint rule with fixed steps; at a millisecond
it is as accurate as RK4, for half the work. At low speed the wheel rotation is stiff, with a rate
of ``R_w^2 C / (I_y_w v)``, so below a few m/s (`CommonRoadCar.slowest`) the package's kinematic
model takes over, as it does in the package below 0.1 m/s.

The equations fail for a wheel that rolls backward, and the kinematic model does not hold for a car
that moves sideways. A car that has spun that far slides to a halt with locked wheels, and drives on
from there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, is_dataclass, replace
from itertools import cycle
from typing import Any, Callable, NamedTuple

from ..control.state import CarState
from ..errors import MapRacingError, ParameterError
from ..validation import documented, finite, parameter
from ..vehicle.single_track import GRAVITY
from .plant import ActuatedCar, PlantParameters

__all__ = ["PARAMETER_SETS", "CommonRoadCar", "CommonRoadParameters"]

# Parameter sets of the package, by its numbers. The fourth is a truck with a trailer.
PARAMETER_SETS = {"ford_escort": 1, "bmw_320i": 2, "vw_vanagon": 3}
# Largest rate of a wheel's rotation under static load, times the step; the stability limit is 2.
STIFFEST = 1.4
# Parameters of the package that its equations do not read.
_UNUSED = frozenset(
    ("l", "w", "h_cg", "kappa_dot_max", "kappa_dot_dot_max", "j_max", "j_dot_max", "trailer")
)
_SUSPENSION = """
    m_s m_uf m_ur I_Phi_s I_y_s I_xz_s K_sf K_sdf K_sr K_sdr T_f T_r K_ras K_tsf K_tsr K_rad K_zt
    h_raf h_rar I_uf I_ur K_lt D_f D_r E_f E_r
"""
_NOT_USED = {"multi_body": _UNUSED, "drift": _UNUSED | frozenset(_SUSPENSION.split())}
# The kinematic model takes over again below this share of the speed at which it hands over.
HYSTERESIS = 0.9
# A car whose lateral velocity exceeds this share of the forward one has spun.
SPUN = 0.5


@documented
@dataclass(frozen=True)
class CommonRoadParameters(PlantParameters):
    """A car of the CommonRoad models; a plant file with ``model: commonroad`` holds these.

    Steering rate and lock are the vehicle's, if lower than the model's. The tires are the model's;
    the vehicle is only what controllers know about the car.
    """

    dynamics: str = parameter(
        "Equations of motion", choices=("multi_body", "drift"), default="multi_body"
    )
    integration_steps: int = parameter(
        "Integration steps in each millisecond", low=1, high=100, default=1
    )
    parameters: Any = field(
        default="bmw_320i",
        metadata=parameter(
            "Parameter set: a name of the package, ford_escort, bmw_320i or vw_vanagon, or in "
            "plant files a mapping of the package's names"
        ).metadata,
    )

    def __post_init__(self):
        super().__post_init__()
        given = self.parameters
        named = isinstance(given, str) and given in PARAMETER_SETS
        if not named and not isinstance(given, dict):
            raise ParameterError(
                f"parameters: expected {', '.join(PARAMETER_SETS)} or a mapping, got {given!r}"
            )


class _Equations(NamedTuple):
    """The package's functions for one kind of dynamics."""

    derivatives: Callable  # of the state, for inputs (steering rate, acceleration)
    initial: Callable  # state from (x, y, delta, v, psi, r, beta)
    axles: tuple[str, ...]  # of the tires, in the order in which the equations read them
    motion: Callable  # (v_x, v_y) from the state
    acceleration: Callable  # (a_x, a_y) from the state and its derivatives


def _equations(dynamics):
    if dynamics == "multi_body":
        from vehiclemodels.init_mb import init_mb
        from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

        return _Equations(
            vehicle_dynamics_mb,
            init_mb,
            ("front", "front", "rear", "rear"),
            lambda x: (x[3], x[10]),
            lambda x, dx: (dx[3] - x[5] * x[10], dx[10] + x[5] * x[3]),
        )
    from vehiclemodels.init_std import init_std
    from vehiclemodels.vehicle_dynamics_std import vehicle_dynamics_std

    return _Equations(
        vehicle_dynamics_std,
        init_std,
        ("front", "rear"),
        lambda x: (x[3] * math.cos(x[6]), x[3] * math.sin(x[6])),
        _drift_acceleration,
    )


def _drift_acceleration(x, dx):
    along, across = dx[3], x[3] * (x[5] + dx[6])
    cos, sin = math.cos(x[6]), math.sin(x[6])
    return along * cos - across * sin, along * sin + across * cos


class CommonRoadCar(ActuatedCar):
    """Plant with the interface of :class:`map_racing.simulation.plant.Plant`.

    Parameters
    ----------
    parameters : CommonRoadParameters

    Attributes
    ----------
    slowest : float
        Speed below which the car is kinematic [m/s].
    sliding : bool
        Whether the car has spun too far for the equations and slides to a halt.
    """

    time_step = 0.001

    def __init__(self, parameters):
        try:
            from vehiclemodels.utils.vehicle_dynamics_ks_cog import vehicle_dynamics_ks_cog

            self._model = _equations(parameters.dynamics)
        except ImportError:
            raise MapRacingError(
                "the plant commonroad needs the package commonroad-vehicle-models: "
                "pip install 'map_racing[rivals]'"
            ) from None
        self._kinematic = vehicle_dynamics_ks_cog
        self._integration_step = self.time_step / parameters.integration_steps
        self.parameters = parameters
        self._nominal = _parameter_set(parameters.parameters, parameters.dynamics)
        self._grip = None
        self.set_grip(1.0)
        super().__init__(parameters)
        self._check()

    def reset(self, x, y, psi, speed=0.0):
        """Place the car's rear axle, driving straight; time starts at 0."""
        super().reset(x, y, psi, speed)
        _, x, y = self.state[:3]
        self.sliding = False
        self._dynamic = speed >= self.slowest
        self._x = [x, y, 0.0, speed, psi]
        if self._dynamic:
            self._x = self._model.initial([*self._x, 0.0, 0.0], self._car)

    def set_grip(self, factor):
        """Multiply the friction of all tires by a factor from the next step on."""
        if factor != self._grip:
            self._grip = factor
            self._car = _scaled(self._nominal, factor, self.parameters, self._model.axles)
            stiffer = max(factor, 1.0) * self.parameters.mu_scale
            self.slowest = stiffer * self._slowest(self._nominal)

    def advance(self, steering_command, speed_command, steps=1):
        """Integrate `steps` time steps under the given commands."""
        for _ in range(steps):
            self._advance(steering_command, speed_command)

    def _advance(self, steering_command, speed_command):
        step = self.time_step
        self._steps += 1
        self._steering_line.append(steering_command)
        self._speed_line.append(speed_command)
        angle = self._servo(self.steering_angle, self._steering_line.popleft(), step)
        if self.sliding:
            self._speed_line.popleft()
            self._slide(angle)
            return
        rate = (angle - self._x[2]) / step
        inputs = rate, self._drive(self._speed_line.popleft(), self.state.v_x)
        try:
            for _ in range(self.parameters.integration_steps):
                self._integrate(inputs)
        except ZeroDivisionError:  # the slip of a wheel that rolls backward
            self.sliding = True
            self._slide(angle)
            return
        self.steering_angle = self._x[2]
        if self._dynamic:
            v_x, v_y = self._model.motion(self._x)
            r = self._x[5]
            if v_x < HYSTERESIS * self.slowest:
                # In the kinematic model a spun car would roll straight ahead.
                self.sliding = abs(v_y) > SPUN * abs(v_x)
                self._dynamic = False
                self._x = [*self._x[:3], math.hypot(v_x, v_y), self._x[4]]
        else:
            # Kinematic sideslip of the center of gravity.
            v, beta = self._x[3], self._kinematic_sideslip()
            v_x, v_y = v * math.cos(beta), v * math.sin(beta)
            r = v_y / self._car.b
            if v > self.slowest:
                self._dynamic = True
                self._x = self._model.initial([*self._x, r, beta], self._car)
        x, y, psi = self._x[0], self._x[1], self._x[4]
        self.state = CarState(self._steps * step, x, y, psi, v_x, v_y, r)

    def _slide(self, angle):
        """Slide with locked wheels and decaying yaw rate until the car stands."""
        step = self.time_step
        _, x, y, psi, v_x, v_y, r = self.state
        speed = math.hypot(v_x, v_y)
        friction = GRAVITY * self._nominal.tire.p_dx1 * self.parameters.mu_scale * self._grip
        left = max(1.0 - friction * step / speed, 0.0) if speed else 0.0
        course, r = psi + math.atan2(v_y, v_x), r * left
        x, y = x + step * speed * math.cos(course), y + step * speed * math.sin(course)
        psi, speed = psi + step * r, speed * left
        self.acceleration = -friction * math.cos(course - psi), -friction * math.sin(course - psi)
        self.steering_angle = angle
        v_x, v_y = speed * math.cos(course - psi), speed * math.sin(course - psi)
        self.state = CarState(self._steps * step, x, y, psi, v_x, v_y, r)
        if not speed:
            self.sliding = self._dynamic = False
            self._x = [x, y, angle, 0.0, psi]

    def _integrate(self, inputs):
        """One step of the midpoint rule."""
        f = self._model.derivatives if self._dynamic else self._kinematic
        x, car, step = self._x, self._car, self._integration_step
        half = 0.5 * step
        k1 = f(x[:], inputs, car)
        k2 = f([a + half * b for a, b in zip(x, k1)], inputs, car)
        if self._dynamic:
            self.acceleration = self._model.acceleration(x, k1)
        else:
            beta = self._kinematic_sideslip()
            along, across = k1[3], x[3] * k1[4]
            cos, sin = math.cos(beta), math.sin(beta)
            self.acceleration = along * cos - across * sin, along * sin + across * cos
        self._x = [a + step * b for a, b in zip(x, k2)]

    def _kinematic_sideslip(self):
        car = self._car
        return math.atan(math.tan(self._x[2]) * car.b / (car.a + car.b))

    def _slowest(self, car):
        """Speed above which the wheels' rotation is slow enough for the integration."""
        load = car.m * GRAVITY * max(car.a, car.b) / (car.a + car.b)
        stiffness = load * car.tire.p_kx1 / (0.5 * len(self._model.axles))
        return self._integration_step * car.R_w**2 * stiffness / (car.I_y_w * STIFFEST)

    def _check(self):
        """Refuse a vehicle file that describes another car."""
        car, vehicle = self._nominal, self.vehicle
        for name, own in (("l_f", car.a), ("l_r", car.b), ("m", car.m)):
            given = getattr(vehicle, name)
            if abs(given - own) > 0.02 * own:
                raise ParameterError(
                    f"vehicle: expected the plant's {name}, {own:g}, got {given:g} in "
                    f"{vehicle.name}"
                )


# -- parameters ------------------------------------------------------------------------------------


def _parameter_set(given, dynamics):
    """The package's parameters, by name or from a mapping."""
    from vehiclemodels.vehicle_parameters import VehicleParameters, setup_vehicle_parameters

    if not isinstance(given, dict):
        return setup_vehicle_parameters(vehicle_id=PARAMETER_SETS[given])
    return _filled(VehicleParameters(), given, "parameters", dynamics)


def _filled(target, values, where, dynamics):
    """A structure of the package with the values of a mapping of the same names."""
    known = [field.name for field in fields(target)]
    for name in values:
        if name not in known:
            raise ParameterError(f"{where}.{name}: unknown (known: {', '.join(sorted(known))})")
    for name in known:
        place = f"{where}.{name}"
        if is_dataclass(getattr(target, name)):
            inner = values.get(name, {})
            if not isinstance(inner, dict):
                raise ParameterError(f"{place}: expected a mapping, got {inner!r}")
            if name != "trailer":
                _filled(getattr(target, name), inner, place, dynamics)
        elif name in values:
            setattr(target, name, finite(place, values[name]))
        elif name not in _NOT_USED[dynamics]:
            raise ParameterError(f"{place}: missing")
    return target


def _scaled(car, grip, parameters, axles):
    """A parameter set with scaled tires.

    The package has one set of tire coefficients for all wheels. If the axles differ, the equations
    get each wheel's own tire when they read it, which they do in a fixed order.
    """
    front, rear = (
        _tire(car.tire, grip * parameters.mu_scale, stiffness)
        for stiffness in (parameters.front_stiffness_scale, parameters.rear_stiffness_scale)
    )
    if front == rear:
        return replace(car, tire=front)
    tires = {"front": front, "rear": rear}
    return _PerAxle(car, [tires[axle] for axle in axles])


def _tire(tire, mu, stiffness):
    """Tire coefficients with all forces scaled by `mu`, cornering stiffness by `stiffness` too."""
    factors = {
        **dict.fromkeys(("p_dx1", "p_kx1", "p_vx1", "p_dy1", "p_vy1", "p_vy3"), mu),
        "p_ky1": mu * stiffness,
    }
    scaled = {name: getattr(tire, name) * factor for name, factor in factors.items()}
    return replace(tire, **scaled)


class _PerAxle:
    """A parameter set whose `tire` returns the tires of the wheels in turn."""

    def __init__(self, car, tires):
        self.__dict__.update(vars(car))
        del self.__dict__["tire"]
        self._turns = cycle(tires)

    @property
    def tire(self):
        return next(self._turns)
