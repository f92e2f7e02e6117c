"""The plant of the public ROS 1 simulator, ``f1tenth_simulator``, as the MAP authors run it.

It serves to check the closed loop against figures that others measured: the CommonRoad single-track
model with linear tires and small angles, Euler steps of 10 ms, a delay line of five samples for
steering commands, a bang-bang servo and a crude speed controller. Model and figures are as
published with that simulator; they reproduce a recording of it up to rounding.
"""

import math
from collections import deque
from dataclasses import dataclass

from ..control.state import CarState
from ..errors import ParameterError
from ..validation import documented, parameter
from ..vehicle.single_track import GRAVITY
from ..vehicle.tires import LinearTire
from .plant import ScaledVehicle

__all__ = ["PublicSimulator", "PublicSimulatorParameters"]


TIME_STEP = 0.01  # of the integration [s]


@documented
@dataclass(frozen=True)
class PublicSimulatorParameters(ScaledVehicle):
    """The car of the public simulator; a plant file with ``model: public_simulator`` holds these.

    The vehicle's tires must be linear, and its poses are exact.
    """

    h_cg_m: float = parameter(
        "Height of the center of gravity, from a recording of the simulator. The published model "
        "file of the same car has 0.02 m, which would hide most of the load transfer under braking",
        "m",
        low=0.0,
        default=0.074,
    )
    steering_delay_s: float = parameter(
        "Dead time of the steering servo, in whole steps of 10 ms",
        "s",
        low=0.0,
        high=1.0,
        default=0.05,
    )
    localization_rate_hz: float = parameter(
        "Poses per second", "Hz", low=1.0, high=1.0 / TIME_STEP, default=40.0
    )

    # The simulator publishes the pose of the center of gravity as base_link.
    reference_point = "center_of_gravity"


class PublicSimulator:
    """Plant with the interface of :class:`map_racing.simulation.plant.Plant`.

    Like the simulator, it reports the pose of the center of gravity as ``base_link`` and no lateral
    velocity.

    Parameters
    ----------
    parameters : PublicSimulatorParameters
        The shipped plant ``public_simulator`` has the figures of that simulator.

    Attributes
    ----------
    speed : float
        Magnitude of the velocity, which the simulator publishes as ``linear.x`` [m/s].
    slip_angle : float
        Angle from heading to velocity [rad].
    """

    time_step = TIME_STEP
    steering_dead_band = 1e-4
    dynamic_above = 0.53  # m/s, entering the dynamic model ...
    kinematic_below = 0.50  # ... and leaving it

    def __init__(self, parameters):
        self.parameters = parameters
        self.vehicle = parameters.build_vehicle()
        if not isinstance(self.vehicle.front, LinearTire):
            raise ParameterError(
                f"public_simulator: expected a vehicle with linear tires, got {self.vehicle.name}"
            )
        self._grip = 1.0
        self.set_drive(1.0, 1.0)
        self.reset(0.0, 0.0, 0.0)

    def set_grip(self, factor):
        """Multiply the friction of both axles by a factor from the next step on."""
        self._grip = factor

    def set_drive(self, acceleration, braking):
        """Scale the drive's acceleration and braking limits from the next step on."""
        vehicle = self.vehicle
        self._drive_limits = vehicle.a_max * acceleration, vehicle.a_brake_max * braking

    def hold(self, x, y, psi):
        """Keep the car in place, at rest; time and steering continue."""
        self.x, self.y, self.psi = x, y, psi
        self.speed = self.slip_angle = self.yaw_rate = 0.0

    def reset(self, x, y, psi, speed=0.0):
        """Place the car, driving straight; time starts at 0."""
        self.x, self.y, self.psi, self.speed = x, y, psi, speed
        self.slip_angle = self.yaw_rate = self.steering_angle = 0.0
        self.acceleration = (0.0, 0.0)
        self._dynamic = False
        self._steps = 0
        delay = round(self.parameters.steering_delay_s / self.time_step)
        self._steering_line = deque([0.0] * delay)

    def reference_state(self):
        """True state of the published pose; the velocity is given along the car's axes."""
        return CarState(
            self._steps * self.time_step,
            self.x,
            self.y,
            self.psi,
            self.speed * math.cos(self.slip_angle),
            self.speed * math.sin(self.slip_angle),
            self.yaw_rate,
        )

    def measured_state(self):
        """State as the simulator publishes it: speed along the heading, no lateral velocity."""
        return self.reference_state()._replace(v_x=self.speed, v_y=math.nan)

    def advance(self, steering_command, speed_command, steps=1):
        """Integrate Euler steps of 10 ms under the given commands."""
        for _ in range(steps):
            self._advance(steering_command, speed_command)

    def _advance(self, steering_command, speed_command):
        vehicle, dt = self.vehicle, self.time_step
        self._steering_line.append(steering_command)
        error = self._steering_line.popleft() - self.steering_angle
        rate = 0.0
        if abs(error) > self.steering_dead_band:
            rate = math.copysign(vehicle.delta_rate_max, error)
        accel = self._acceleration(speed_command)

        v, beta, r, delta = self.speed, self.slip_angle, self.yaw_rate, self.steering_angle
        model = self._dynamic_model if self._is_dynamic(v) else self._kinematic_model
        beta_dot, r_dot = model(v, beta, r, delta, rate, accel)
        course = self.psi + beta
        self.acceleration = (accel, v * (r + beta_dot))
        self.x += dt * v * math.cos(course)
        self.y += dt * v * math.sin(course)
        self.psi += dt * (r if self._dynamic else self._kinematic_yaw_rate(v, beta, delta))
        self.speed = min(max(v + dt * accel, -vehicle.v_max), vehicle.v_max)
        self.slip_angle += dt * beta_dot
        self.yaw_rate += dt * r_dot
        lock = vehicle.delta_max
        self.steering_angle = min(max(delta + dt * rate, -lock), lock)
        self._steps += 1

    def _acceleration(self, target):
        """Proportional when accelerating, full when braking."""
        most, braking = self._drive_limits
        error = target - self.speed
        if error > 0.0 or self.speed <= 0.0:
            proportional = 2.0 * self.vehicle.a_max / self.vehicle.v_max * error
            return min(max(proportional, -most), most)
        return -braking

    def _is_dynamic(self, v):
        self._dynamic = v >= (self.kinematic_below if self._dynamic else self.dynamic_above)
        return self._dynamic

    def _dynamic_model(self, v, beta, r, delta, rate, accel):
        """Linear single-track model with load transfer: ``beta'`` and ``r'``."""
        vehicle = self.vehicle
        l_f, l_r, l_wb, h_cg = vehicle.l_f, vehicle.l_r, vehicle.l_wb, self.parameters.h_cg_m
        mu = vehicle.mu * self._grip
        front = mu * vehicle.front.C_S * (GRAVITY * l_r - accel * h_cg) / l_wb
        rear = mu * vehicle.rear.C_S * (GRAVITY * l_f + accel * h_cg) / l_wb
        # Axle forces per mass: stiffness times slip angle, positive to the left.
        force_front = front * (delta - beta - l_f * r / v)
        force_rear = rear * (-beta + l_r * r / v)
        beta_dot = (force_front + force_rear) / v - r
        r_dot = vehicle.m / vehicle.I_z * (l_f * force_front - l_r * force_rear)
        return beta_dot, r_dot

    def _kinematic_yaw_rate(self, v, beta, delta):
        return v * math.tan(delta) * math.cos(beta) / self.vehicle.l_wb

    def _kinematic_model(self, v, beta, r, delta, rate, accel):
        """Kinematic single-track model, differentiated, for low speed."""
        l_wb, l_r = self.vehicle.l_wb, self.vehicle.l_r
        tan, cos = math.tan(delta), math.cos(delta)
        beta_dot = l_r / (l_wb * cos * cos) / (1.0 + (l_r / l_wb * tan) ** 2) * rate
        r_dot = (
            accel * tan * math.cos(beta)
            + v * rate * math.cos(beta) / (cos * cos)
            - v * math.sin(beta) * tan * beta_dot
        ) / l_wb
        return beta_dot, r_dot
