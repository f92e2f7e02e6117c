"""The simulated car: single-track dynamics with realistic actuators and localization.

The plant has its own parameters. A controller tested only against its own model proves nothing, so
a plant file names a vehicle and how much the plant's tires differ from it.
"""

from __future__ import annotations

import math
import random
from collections import deque
from dataclasses import dataclass, replace

from ..control.state import CarState, moved
from ..errors import ParameterError
from ..validation import POSITIVE, check, documented, parameter
from ..vehicle.parameters import Vehicle, load_vehicle, scaled_tires
from ..vehicle.single_track import V_EPS, fastest_mode, single_track_derivatives
from .grip import read_grip_changes

__all__ = [
    "ActuatedCar",
    "Localization",
    "Plant",
    "PlantParameters",
    "ScaledVehicle",
]

TIME_STEP = 0.002  # of the integration [s]


def _scale(what):
    return parameter(f"{what}, relative to the vehicle's", low=0.1, high=3.0, default=1.0)


def _delay(what):
    return parameter(what, "s", low=0.0, high=1.0, default=0.0)


def _noise(what, unit, most):
    # A larger value must be in another unit, such as mm or degrees.
    text = f"Standard deviation of white noise on {what}"
    return parameter(text, unit, low=0.0, high=most, default=0.0)


@dataclass(frozen=True)
class ScaledVehicle:
    """Parameters of all plants: a vehicle, and how far the tires differ from the vehicle file."""

    vehicle: str | Vehicle = parameter(
        "Geometry, masses, limits and nominal tires: a Vehicle, or in files the name of a shipped "
        "vehicle or the path of a vehicle file, relative to the plant's own file"
    )
    mu_scale: float = _scale("Friction coefficient")
    front_stiffness_scale: float = _scale("Cornering stiffness of the front tires")
    rear_stiffness_scale: float = _scale("Cornering stiffness of the rear tires")
    grip_changes: tuple = parameter(
        "Changes of the friction during a race: mappings with a factor, and time or place",
        default=(),
    )

    def __post_init__(self):
        check(self)
        object.__setattr__(self, "grip_changes", read_grip_changes(self.grip_changes))
        if not isinstance(self.vehicle, (str, Vehicle)) or not self.vehicle:
            raise ParameterError(f"vehicle: expected a name or a path, got {self.vehicle!r}")

    def build_vehicle(self) -> Vehicle:
        """The vehicle with the plant's own tires."""
        vehicle = self.vehicle
        if not isinstance(vehicle, Vehicle):
            vehicle = load_vehicle(vehicle)
        return scaled_tires(
            vehicle, self.mu_scale, self.front_stiffness_scale, self.rear_stiffness_scale
        )


@documented
@dataclass(frozen=True)
class PlantParameters(ScaledVehicle):
    """A simulated car; a file in ``config/plants`` holds the same names.

    Steering rate and lock are the vehicle's.
    """

    steering_delay_s: float = _delay("Dead time of the steering servo")
    steering_time_constant_s: float = parameter(
        "First-order lag of the steering servo", "s", low=0.0, high=2.0, default=0.0
    )
    drive_delay_s: float = _delay("Dead time of the speed controller")
    drive_time_constant_s: float = parameter(
        "First-order lag of the speed controller", "s", low=POSITIVE, high=5.0, default=0.1
    )
    a_max_mps2: float = parameter(
        "Largest acceleration of the drive", "m/s^2", low=POSITIVE, default=7.51
    )
    a_brake_max_mps2: float = parameter(
        "Largest deceleration of the drive", "m/s^2", low=POSITIVE, default=8.26
    )
    localization_rate_hz: float = parameter(
        "Poses per second", "Hz", low=1.0, high=1.0 / TIME_STEP, default=40.0
    )
    localization_latency_s: float = _delay("Age of a pose on arrival")
    position_noise_m: float = _noise("the position", "m", 1.0)
    heading_noise_rad: float = _noise("the heading", "rad", 0.5)
    velocity_noise_mps: float = _noise("the velocity", "m/s", 5.0)
    yaw_rate_noise_radps: float = _noise("the yaw rate", "rad/s", 2.0)
    acceleration_noise_mps2: float = _noise("the acceleration that the IMU reports", "m/s^2", 20.0)
    measures_v_y: bool = parameter(
        "Whether the odometry reports the lateral velocity; otherwise it is NaN", default=True
    )

    reference_point = "rear_axle"

    def build_vehicle(self) -> Vehicle:
        """The vehicle with the plant's own tires and drive."""
        vehicle = super().build_vehicle()
        return replace(vehicle, a_max=self.a_max_mps2, a_brake_max=self.a_brake_max_mps2)


class ActuatedCar:
    """Base of the cars of :class:`PlantParameters`: servo, drive, and the rear axle's pose.

    The state refers to the center of gravity, the reported pose to the rear axle (``base_link``).
    Subclasses integrate the state in ``advance``.

    Parameters
    ----------
    parameters : PlantParameters

    Attributes
    ----------
    state : CarState
        True state of the center of gravity.
    steering_angle : float
        True steering angle [rad].
    acceleration : tuple of float
        True longitudinal and lateral acceleration of the center of gravity [m/s^2].
    """

    time_step = TIME_STEP

    def __init__(self, parameters):
        self.parameters = parameters
        self.vehicle = parameters.build_vehicle()
        lag = parameters.steering_time_constant_s
        self._servo_gain = 1.0 - math.exp(-self.time_step / lag) if lag else 1.0
        self.set_drive(1.0, 1.0)
        # With a lag shorter than the step, braking would overshoot into reverse.
        self._drive_lag = max(parameters.drive_time_constant_s, self.time_step)
        self.reset(0.0, 0.0, 0.0)

    def reset(self, x, y, psi, speed=0.0):
        """Place the car's rear axle, driving straight; time starts at 0."""
        self.state = moved(CarState(0.0, x, y, psi, speed, 0.0, 0.0), self.vehicle.l_r)
        self.steering_angle = 0.0
        self.acceleration = (0.0, 0.0)
        self._steps = 0
        step = self.time_step
        self._steering_line = deque([0.0] * round(self.parameters.steering_delay_s / step))
        self._speed_line = deque([speed] * round(self.parameters.drive_delay_s / step))

    def reference_state(self):
        """True state of the rear axle, which localization reports and which follows the line."""
        return moved(self.state, -self.vehicle.l_r)

    def set_drive(self, acceleration, braking):
        """Scale the drive's acceleration and braking limits from the next step on."""
        vehicle = self.vehicle
        self._drive_limits = vehicle.a_max * acceleration, -vehicle.a_brake_max * braking

    def _servo(self, angle, target, step):
        """Servo: first-order lag within rate and lock."""
        # Comparisons, because min and max take three times as long.
        vehicle = self.vehicle
        lock, slew = vehicle.delta_max, vehicle.delta_rate_max * step
        target = lock if target > lock else -lock if target < -lock else target
        move = (target - angle) * self._servo_gain
        return angle + (slew if move > slew else -slew if move < -slew else move)

    def _drive(self, target, v_x):
        """Longitudinal acceleration of the speed controller [m/s^2]; it never drives backwards."""
        vehicle = self.vehicle
        most, least = self._drive_limits
        target = 0.0 if target < 0.0 else vehicle.v_max if target > vehicle.v_max else target
        wanted = (target - v_x) / self._drive_lag
        return most if wanted > most else least if wanted < least else wanted


class Plant(ActuatedCar):
    """Single-track car with load transfer, integrated by RK4 (4th-order Runge-Kutta)."""

    def __init__(self, parameters):
        super().__init__(parameters)
        self._fastest, self._grip = fastest_mode(self.vehicle), None
        self.set_grip(1.0)

    def set_grip(self, factor):
        """Multiply the friction of both axles by a factor from the next step on."""
        if factor != self._grip:
            self._grip = factor
            vehicle = replace(self.vehicle, mu=self.vehicle.mu * factor)
            # RK4 is stable up to a rate of 2.78 per step. Tires too stiff for that at low speed are
            # damped up to a higher speed.
            v_eps = max(V_EPS, factor * self._fastest * self.time_step / 2.5)
            self._derivatives = single_track_derivatives(vehicle, v_eps)

    def hold(self, x, y, psi):
        """Keep the rear axle in place, at rest; time and actuators continue."""
        self.state = moved(CarState(self.state.t, x, y, psi, 0.0, 0.0, 0.0), self.vehicle.l_r)

    def advance(self, steering_command, speed_command, steps=1):
        """Integrate `steps` time steps under the given commands."""
        step, servo, drive = self.time_step, self._servo, self._drive
        half, sixth = 0.5 * step, step / 6.0
        steering_line, speed_line = self._steering_line, self._speed_line
        derivatives, cos, sin = self._derivatives, math.cos, math.sin
        _, x, y, psi, v_x, v_y, r = self.state
        delta_end = self.steering_angle
        for _ in range(steps):
            steering_line.append(steering_command)
            speed_line.append(speed_command)
            delta_start = delta_end
            delta_end = servo(delta_start, steering_line.popleft(), step)
            a_long = drive(speed_line.popleft(), v_x)
            delta_mid = 0.5 * (delta_start + delta_end)
            v_mid, v_end = v_x + half * a_long, v_x + step * a_long

            dv1, dr1 = derivatives(v_x, v_y, r, delta_start, a_long)
            v_y2, r2, psi2 = v_y + half * dv1, r + half * dr1, psi + half * r
            dv2, dr2 = derivatives(v_mid, v_y2, r2, delta_mid, a_long)
            v_y3, r3, psi3 = v_y + half * dv2, r + half * dr2, psi + half * r2
            dv3, dr3 = derivatives(v_mid, v_y3, r3, delta_mid, a_long)
            v_y4, r4, psi4 = v_y + step * dv3, r + step * dr3, psi + step * r3
            dv4, dr4 = derivatives(v_end, v_y4, r4, delta_end, a_long)

            c1, s1, c2, s2 = cos(psi), sin(psi), cos(psi2), sin(psi2)
            c3, s3, c4, s4 = cos(psi3), sin(psi3), cos(psi4), sin(psi4)
            middle = v_mid * c2 - v_y2 * s2 + v_mid * c3 - v_y3 * s3
            x += sixth * (v_x * c1 - v_y * s1 + 2.0 * middle + v_end * c4 - v_y4 * s4)
            middle = v_mid * s2 + v_y2 * c2 + v_mid * s3 + v_y3 * c3
            y += sixth * (v_x * s1 + v_y * c1 + 2.0 * middle + v_end * s4 + v_y4 * c4)
            a_lat = dv1 + v_x * r
            psi += sixth * (r + 2.0 * (r2 + r3) + r4)
            v_x = v_end
            v_y += sixth * (dv1 + 2.0 * (dv2 + dv3) + dv4)
            r += sixth * (dr1 + 2.0 * (dr2 + dr3) + dr4)
        self._steps += steps
        self.steering_angle = delta_end
        self.acceleration = (a_long, a_lat)
        self.state = CarState(self._steps * step, x, y, psi, v_x, v_y, r)


class Localization:
    """White noise on the car's measurements, from a seed.

    Parameters
    ----------
    parameters : PlantParameters
    seed : int
        Two runs with the same seed are identical.
    """

    def __init__(self, parameters, seed):
        self.parameters = parameters
        self._gauss = random.Random(seed).gauss

    def measure(self, state):
        """A noisy copy of a true state.

        Parameters
        ----------
        state : CarState

        Returns
        -------
        CarState
            ``v_y`` is NaN if the plant does not measure it.
        """
        parameters, gauss = self.parameters, self._gauss
        return CarState(
            state.t,
            state.x + gauss(0.0, parameters.position_noise_m),
            state.y + gauss(0.0, parameters.position_noise_m),
            state.psi + gauss(0.0, parameters.heading_noise_rad),
            state.v_x + gauss(0.0, parameters.velocity_noise_mps),
            state.v_y + gauss(0.0, parameters.velocity_noise_mps)
            if parameters.measures_v_y
            else math.nan,
            state.r + gauss(0.0, parameters.yaw_rate_noise_radps),
        )

    def measure_acceleration(self, acceleration):
        """Noisy longitudinal and lateral acceleration [m/s^2], as from an IMU."""
        noise = self.parameters.acceleration_noise_mps2
        return tuple(value + self._gauss(0.0, noise) for value in acceleration)
