"""Grip, tires and delay of the day, learned while driving.

An extended Kalman filter runs the single-track model of `map_racing.vehicle.single_track` in
parallel with the car. Its state holds the lateral velocity and yaw rate, plus the unknown
parameters: logarithms of the factors on friction and on front and rear cornering stiffness, the
dead time from a pose to the first response of the steering, the servo lag, and the height of the
center of gravity, which sets the load transfer under braking. Yaw rate and, if measured, lateral
velocity correct all of them at once, as far as the maneuver makes them observable: below the limit
only the product of friction and stiffness, near it both, and delays on turn-in and corner exit.

The controller uses a cautious version of that belief, see `Adaptation`.
"""

from __future__ import annotations

import math

from .. import __version__
from ..vehicle.parameters import parameter_hash, scaled_tires
from ..vehicle.single_track import GRAVITY
from ..vehicle.tire_steering import TireSteering
from .belief import Belief

__all__ = ["Adaptation"]

# Standard deviations of the prior: logarithms of friction, front and rear stiffness; dead time and
# lag [s]. On ten days in the paper's conditions friction is off by 5 % and stiffness by 10 %; a
# vehicle file that somebody else identified is off by more.
PRIOR = (0.10, 0.20, 0.25, 0.025, 0.015)
# Height of the center of gravity, in wheelbases: standard deviation of the prior (scales do not
# show the height), and upper bound.
HEIGHT, HIGHEST = 0.1, 0.5
# Random walk of the states in PRIOR, per square root of a second of cornering at the limit: tires
# warm up and floors get dusty by some percent in a minute.
WALK = (0.010, 0.010, 0.010, 0.001, 0.001)
# Measurement noise [m/s, rad/s], and process noise per square root of a second.
MEASURED_V_Y, MEASURED_R = 0.06, 0.03
MODEL_V_Y, MODEL_R = 0.1, 0.3
# The measurement variance is inflated while innovations are larger than they should be: largest
# factor, and gains with which it rises and falls per measurement.
NOISIEST, RISING, FALLING = 16.0, 0.2, 0.02
# Servo lag [s]: prior and bounds. Upper bound of the dead time, which includes the pose's age.
SERVO_LAG, SHORTEST_LAG, LONGEST_LAG, LONGEST_DEAD_TIME = 0.03, 0.005, 0.12, 0.25
# Longest time step of the model [s], and longest gap between poses that it is integrated over.
STEP, LONGEST_PAUSE = 0.0125, 0.1

# Learning is off below this speed [m/s], below this share of the grip, beyond this sideslip angle
# [rad], and for a measurement this many standard deviations off, a 1 in 16000 event: a curb or a
# jump of the localization.
SLOWEST, LEAST_USE, SLIDE, OUTLIER = 1.5, 0.2, 0.5, 4.0
# Why a pose taught nothing.
NO_POSE, SLOW, STRAIGHT = "no earlier pose", "too slow", "too little grip in use"
SLIDING, UNLIKELY = "sliding", "a pose that the belief cannot explain"

# A yaw rate that stays this many standard deviations short of the model's, on average over about
# 0.1 s, means that the floor has changed: the deviation of log friction is raised to CHANGED.
SHORT, MEMORY, CHANGED = 1.0, 0.25, 0.10

# The speeds use the grip at this many standard deviations below the belief.
CAUTION = 1.0
# The grip in use drops at once, but rises only by this much per second, while the car uses at least
# this share of it.
RISE, NEAR = 0.03, 0.7
# The delay in use moves at most by this much per second of learning: a single bend may mislead.
DELAY_RATE = 0.01
# The steering map is updated once a factor has moved by more than this share of its deviation.
NOTABLE = 0.25


_QUANTILE = 1.96  # of a normal distribution, for 95 %


class Adaptation:
    """Learns grip, cornering stiffness and delay from a stream of poses and commands.

    The result depends only on these, whether live, simulated or recorded. An update takes 0.06 ms.
    The speeds follow the lower end of the belief: down at once, up slowly and only while the car
    drives near the limit. All factors stay within a share of the vehicle file's tires. Where the
    data carry no information (straights, stops, slides, curbs) the belief does not change.

    Parameters
    ----------
    vehicle : Vehicle
        Its tires are the prior.
    v_max : float
        Largest speed [m/s].
    delay : float
        Prior of the delay [s].
    share : float, optional
        Factors stay within ``1 - share`` and ``1 + share``.
    behind : float, optional
        Distance from the center of gravity back to the localized point [m]; by default that point
        is the rear axle.

    Attributes
    ----------
    steering : TireSteering
        Steering map of the believed tires; replaced by a new object when the belief changes.
    grips : list of float
        Lateral limits that the speeds use, relative to the vehicle file's, for `TireSteering.at`.
    delay : float
        Delay that the controller uses [s]; it follows the believed one slowly.
    slowest : float
        Speed in the slowest bend [m/s]: at and above it the lateral limit matters. May be set.
    frozen : str
        Why nothing was learned from the latest pose; empty if something was.
    learned_s : float
        Duration of the driving that was learned from [s].
    """

    def __init__(self, vehicle, v_max, delay, share=0.4, behind=None):
        self.vehicle = vehicle
        self._behind = vehicle.l_r if behind is None else behind
        self._prior_delay = delay
        self._bounds = math.log(1.0 - share), math.log(1.0 + share)
        self._front, self._rear = (
            tire.scalar_with_slope() for tire in (vehicle.front, vehicle.rear)
        )
        self.file_steering = TireSteering(vehicle, v_max)
        self.slowest = 1.0
        self.forget()

    def forget(self):
        """Believe the vehicle file again."""
        car = self.vehicle
        self._x = [0.0, 0.0, 0.0, 0.0, 0.0, self._prior_dead_time(), SERVO_LAG, car.h_cg]
        self._P = [[0.0] * 8 for _ in range(8)]
        for i, deviation in enumerate((*PRIOR, HEIGHT * car.l_wb), 2):
            self._P[i][i] = deviation * deviation
        self.steering, self._used = self.file_steering, self._x[:]
        self.grips = [math.exp(-CAUTION * PRIOR[0])] * len(self.steering.levels)
        self.learned_s = 0.0
        self._noise = 1.0
        self.delay = self._x[5] + self._x[6]
        self.restart()

    def expect_delay(self, delay):
        """Restart learning the delay from a new prior [s]; an unchanged prior does nothing."""
        if delay == self._prior_delay:
            return
        self._prior_delay = delay
        self._x[5:7] = self._prior_dead_time(), SERVO_LAG
        P = self._P
        for k, deviation in ((5, PRIOR[3]), (6, PRIOR[4])):
            for i in range(8):
                P[k][i] = P[i][k] = 0.0
            P[k][k] = deviation * deviation
        self.delay = self._x[5] + self._x[6]

    def _prior_dead_time(self):
        return min(max(self._prior_delay - SERVO_LAG, 0.0), LONGEST_DEAD_TIME)

    def restart(self):
        """Forget the motion, after a pause or when the car was moved; the belief stays."""
        self._t, self.frozen = None, NO_POSE
        self._angle = self._angle_slope = 0.0
        self._times, self._angles = [], []
        self._short = 0.0

    @property
    def level(self):
        """Believed lateral limit, relative to the vehicle file's."""
        return self.steering.level(self.slowest)

    @property
    def grip(self):
        """The least of `grips`, as in `Belief`."""
        return self.steering.least(self.slowest, self.grips)

    @property
    def belief(self):
        """The present `Belief`."""
        x, P = self._x, self._P
        numbers = []
        for k in (2, 3, 4):
            width = math.exp(_QUANTILE * math.sqrt(P[k][k]))
            value = math.exp(x[k])
            numbers += value, value / width, value * width
        delay = x[5] + x[6]
        width = _QUANTILE * math.sqrt(max(P[5][5] + P[6][6] + 2.0 * P[5][6], 0.0))
        return Belief(*numbers, delay, max(delay - width, 0.0), delay + width, self.grip)

    def believed_vehicle(self):
        """The vehicle with the believed tires."""
        return scaled_tires(self.vehicle, *self.belief.factors)

    def summary(self):
        """What was learned, and from how much driving, as a few lines of text."""
        b = self.belief
        return (
            f"Tires learned by map_racing {__version__} from {self.learned_s:.0f} s of driving; "
            f"the rest is of {self.vehicle.name} ({parameter_hash(self.vehicle)}).\n"
            f"Relative to it (95 %): friction {b.friction:.3f} ({b.friction_low:.3f} to "
            f"{b.friction_high:.3f}), cornering stiffness in front {b.front_stiffness:.3f} "
            f"({b.front_stiffness_low:.3f} to {b.front_stiffness_high:.3f}), behind "
            f"{b.rear_stiffness:.3f} ({b.rear_stiffness_low:.3f} to {b.rear_stiffness_high:.3f}).\n"
            f"Delay {b.delay:.3f} s ({b.delay_low:.3f} to {b.delay_high:.3f} s)."
        )

    def update(self, state, steering_angle):
        """Learn from a pose, then record the command sent in response.

        Parameters
        ----------
        state : CarState
            As measured; ``v_y`` is NaN if it is not measured. A pose that is not later than the
            last one, or more than 0.1 s later, restarts the model.
        steering_angle : float
            Angle sent to the car for this pose [rad].

        Returns
        -------
        bool
            Whether `steering` has been replaced.
        """
        t, _, _, _, v_x, v_y, r = state
        changed = False
        last = self._t
        if last is None or not 0.0 < t - last <= LONGEST_PAUSE or v_x < SLOWEST:
            if last is None or not 0.0 < t - last <= LONGEST_PAUSE:
                self.restart()
            else:
                self.frozen = SLOW
            self._settle(t, v_y, r)
        else:
            elapsed = t - last
            use = self._predict(elapsed, 0.5 * (v_x + self._v_x), (v_x - self._v_x) / elapsed)
            changed = self._correct(elapsed, use, v_x, v_y, r)
        self._t, self._v_x = t, v_x
        times, angles = self._times, self._angles
        times.append(t)
        angles.append(steering_angle)
        while times[1 if len(times) > 1 else 0] < t - LONGEST_DEAD_TIME - LONGEST_PAUSE:
            del times[0], angles[0]
        return changed

    def _settle(self, t, v_y, r):
        """Start the model from the measured motion and the commanded steering angle."""
        if self._times:
            end = t - self._x[5]
            self._angle, self._angle_slope = self._commanded(end - STEP, end), 0.0
        self._x[0] = v_y + self._behind * r if v_y == v_y else self.vehicle.l_r * r
        self._x[1] = r
        P = self._P
        for i in range(8):
            P[0][i] = P[1][i] = P[i][0] = P[i][1] = 0.0
        P[0][0], P[1][1] = 0.1**2, 0.05**2
        self._a_long = 0.0
        self._short = 0.0

    def _commanded(self, begin, end):
        """Mean of the zero-order-held commands between two times [rad]."""
        times, angles = self._times, self._angles
        total, until = 0.0, end
        for i in range(len(times) - 1, -1, -1):
            since = times[i]
            if since < until:
                if since <= begin:
                    return (total + angles[i] * (until - begin)) / (end - begin)
                total += angles[i] * (until - since)
                until = since
        return (total + angles[0] * (until - begin)) / (end - begin)

    def _predict(self, elapsed, v, a_long):
        """Integrate the model and its covariance, and return the share of the grip in use.

        The steps are linearly implicit trapezoidal, because the lateral mode of stiff tires is ten
        times faster than the poses.
        """
        car, x = self.vehicle, self._x
        v_y, r, friction, front, rear, dead, lag, height = x
        k_front, k_rear = math.exp(front), math.exp(rear)
        self._a_long += (a_long - self._a_long) * elapsed / (0.1 + elapsed)
        scale = car.mu * math.exp(friction) / car.l_wb
        shift = scale * self._a_long
        load_f = scale * GRAVITY * car.l_r - shift * height
        load_r = scale * GRAVITY * car.l_f + shift * height
        inertia = car.m / car.I_z
        l_f, l_r = car.l_f, car.l_r
        count = math.ceil(elapsed / STEP - 1e-6)
        h = elapsed / count
        half = 0.5 * h
        follow = 1.0 - math.exp(-h / lag)
        slope = self._angle_slope
        # Derivatives of the final motion with respect to the initial motion (a) and to the learned
        # parameters (g); `slope` is the derivative of the steering angle by the lag.
        a00 = a11 = 1.0
        a01 = a10 = 0.0
        g = [0.0] * 12
        begin = self._t - dead
        for i in range(count):
            before = self._angle
            after = before + follow * (self._commanded(begin + i * h, begin + i * h + h) - before)
            self._angle = after
            turning = (after - before) / h
            slope += follow * (-turning - slope)
            tan_f, tan_r = (v_y + l_f * r) / v, (v_y - l_r * r) / v
            slip_f, slip_r = 0.5 * (before + after) - math.atan(tan_f), -math.atan(tan_r)
            share_f, slope_f = self._front(k_front * slip_f)
            share_r, slope_r = self._rear(k_rear * slip_r)
            f_f, f_r = load_f * share_f, load_r * share_r
            d_f, d_r = load_f * k_front * slope_f, load_r * k_rear * slope_r
            c_f, c_r = d_f / (v * (1.0 + tan_f * tan_f)), d_r / (v * (1.0 + tan_r * tan_r))
            # Jacobian with respect to the motion (j) and the learned parameters (s).
            j00, j01 = -c_f - c_r, l_r * c_r - l_f * c_f - v
            j10 = inertia * (l_r * c_r - l_f * c_f)
            j11 = -inertia * (l_f * l_f * c_f + l_r * l_r * c_r)
            s_f, s_r, s_d, s_l = d_f * slip_f, d_r * slip_r, -d_f * turning, d_f * slope
            moment = inertia * (l_f * f_f - l_r * f_r)
            # Inverse of 1 - h/2 J.
            m00, m01, m10, m11 = 1.0 - half * j11, half * j01, half * j10, 1.0 - half * j00
            scale = 1.0 / (m00 * m11 - m01 * m10)
            m00, m01, m10, m11 = m00 * scale, m01 * scale, m10 * scale, m11 * scale
            lateral = f_f + f_r - v * r
            v_y += h * (m00 * lateral + m01 * moment)
            r += h * (m10 * lateral + m11 * moment)
            # The transition is 2 M - 1.
            b00, b01, b10, b11 = 2.0 * m00 - 1.0, 2.0 * m01, 2.0 * m10, 2.0 * m11 - 1.0
            a00, a10 = b00 * a00 + b01 * a10, b10 * a00 + b11 * a10
            a01, a11 = b00 * a01 + b01 * a11, b10 * a01 + b11 * a11
            lever_f, lever_r = inertia * l_f, -inertia * l_r
            for k, p, q in (
                (0, f_f + f_r, moment),
                (1, s_f, lever_f * s_f),
                (2, s_r, lever_r * s_r),
                (3, s_d, lever_f * s_d),
                (4, s_l, lever_f * s_l),
                (5, shift * (share_r - share_f), -shift * (lever_f * share_f - lever_r * share_r)),
            ):
                upper, lower = g[k], g[k + 6]
                g[k] = b00 * upper + b01 * lower + h * (m00 * p + m01 * q)
                g[k + 6] = b10 * upper + b11 * lower + h * (m10 * p + m11 * q)
        x[0], x[1] = v_y, r
        self._angle_slope = slope
        self._spread(a00, a01, a10, a11, g)
        use = v * r / self.steering.limit(v)
        return -use if use < 0.0 else use

    def _spread(self, a00, a01, a10, a11, g):
        """Propagate the covariance."""
        P = self._P
        g0, g1, g2, g3, g4, g5, e0, e1, e2, e3, e4, e5 = g
        upper, lower = [], []
        for p0, p1, p2, p3, p4, p5, p6, p7 in P:
            learned = g0 * p2 + g1 * p3 + g2 * p4 + g3 * p5 + g4 * p6 + g5 * p7
            upper.append(a00 * p0 + a01 * p1 + learned)
            learned = e0 * p2 + e1 * p3 + e2 * p4 + e3 * p5 + e4 * p6 + e5 * p7
            lower.append(a10 * p0 + a11 * p1 + learned)
        w0, w1, w2, w3, w4, w5, w6, w7 = upper
        u0, u1, u2, u3, u4, u5, u6, u7 = lower
        both = a10 * w0 + a11 * w1 + e0 * w2 + e1 * w3 + e2 * w4 + e3 * w5 + e4 * w6 + e5 * w7
        upper[0] = a00 * w0 + a01 * w1 + g0 * w2 + g1 * w3 + g2 * w4 + g3 * w5 + g4 * w6 + g5 * w7
        lower[1] = a10 * u0 + a11 * u1 + e0 * u2 + e1 * u3 + e2 * u4 + e3 * u5 + e4 * u6 + e5 * u7
        upper[1] = lower[0] = both
        P[0], P[1] = upper, lower
        for k in range(2, 8):
            row = P[k]
            row[0], row[1] = upper[k], lower[k]

    def _correct(self, elapsed, use, v_x, v_y, r):
        """Correct motion and belief by the measurements; return whether the map changed."""
        P, x = self._P, self._x
        P[0][0] += MODEL_V_Y * MODEL_V_Y * elapsed
        P[1][1] += MODEL_R * MODEL_R * elapsed
        slides = abs(x[0]) > SLIDE * v_x
        learning = use > LEAST_USE and not slides
        self.frozen = "" if learning else SLIDING if slides else STRAIGHT
        if learning:
            self.learned_s += elapsed
            walked = use * use if use < 1.0 else 1.0
            for k, walk in enumerate(WALK, 2):
                P[k][k] += (walk * walked) ** 2 * elapsed
            self._notice_change(r)
        self._measure(P[1][:], r - x[1], P[1][1], MEASURED_R * MEASURED_R, learning)
        if v_y == v_y:
            behind = self._behind
            column = [p[0] - behind * p[1] for p in self._P]
            own, noise = column[0] - behind * column[1], MEASURED_V_Y * MEASURED_V_Y
            self._measure(column, v_y - x[0] + behind * x[1], own, noise, learning)
        return self._follow(elapsed, use) if learning else False

    def _notice_change(self, r):
        """Reopen the friction's uncertainty if the car keeps turning less than the model."""
        P, x = self._P, self._x
        missing = x[1] - r if x[1] > 0.0 else r - x[1]
        missing /= math.sqrt(MEASURED_R * MEASURED_R + P[1][1])
        self._short += MEMORY * (missing - self._short)
        if self._short > SHORT and P[2][2] < CHANGED * CHANGED:
            P[2][2] = CHANGED * CHANGED

    def _measure(self, column, difference, own, noise, learning):
        """Apply one scalar measurement, whose covariance with the state is `column`.

        The innovation's variance is `own`, predicted by the model, plus `noise`. Where the model is
        wrong, innovations stay larger than that; the noise is then inflated, so that a model
        error does not make the belief more confident.
        """
        x, P = self._x, self._P
        unlikely = difference * difference / (own + noise)
        rise = unlikely - self._noise
        self._noise += (RISING if rise > 0.0 else FALLING) * rise
        self._noise = (
            1.0 if self._noise < 1.0 else NOISIEST if self._noise > NOISIEST else self._noise
        )
        variance = own + noise * self._noise
        if difference * difference > OUTLIER * OUTLIER * variance:
            variance = abs(difference) * math.sqrt(variance) / OUTLIER
            if learning:
                learning, self.frozen = False, UNLIKELY
        gains = [c / variance for c in column]
        if not learning:
            # Schmidt-Kalman update: correct the motion alone and keep the belief, but account for
            # their correlation.
            for k in (0, 1):
                gain = gains[k]
                x[k] += gain * difference
                P[k] = [p - gain * c for p, c in zip(P[k], column)]
            for k in range(2, 8):
                P[k][0], P[k][1] = P[0][k], P[1][k]
            return
        for k in range(8):
            x[k] += gains[k] * difference
        low, high = self._bounds
        for k in (2, 3, 4):
            x[k] = low if x[k] < low else high if x[k] > high else x[k]
        x[5] = min(max(x[5], 0.0), LONGEST_DEAD_TIME)
        x[6] = min(max(x[6], SHORTEST_LAG), LONGEST_LAG)
        x[7] = min(max(x[7], 0.0), HIGHEST * self.vehicle.l_wb)
        self._P = [[p - k * c for p, c in zip(row, column)] for row, k in zip(P, gains)]

    def _follow(self, elapsed, use):
        """Update steering map, delay and grips from the belief; return whether the map changed."""
        x, P, used = self._x, self._P, self._used
        changed = False
        for k in (2, 3, 4):
            moved = x[k] - used[k]
            if moved * moved > NOTABLE * NOTABLE * P[k][k]:
                changed = True
        if changed:
            self._used = x[:]
            self.steering = self.file_steering.scaled(*(math.exp(x[k]) for k in (2, 3, 4)))
        most = DELAY_RATE * elapsed
        self.delay += min(max(x[5] + x[6] - self.delay, -most), most)
        caution = math.exp(-CAUTION * math.sqrt(P[2][2]))
        rise = RISE * elapsed if use * self.level > NEAR * self.grip else 0.0
        self.grips = [
            min(grip + rise, caution * level)
            for grip, level in zip(self.grips, self.steering.levels)
        ]
        return changed
