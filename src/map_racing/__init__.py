"""Model- and Acceleration-based Pursuit (MAP) for 1:10 race cars.

Conventions, everywhere in the package:

- SI units and radians.
- REP-103: x forward, y left, yaw counter-clockwise. Steering angle, lateral acceleration, lateral
  error ``d`` and curvature are therefore positive to the left.
- Names at the boundaries (files, tables, messages, command line) carry their unit: ``s_m``,
  ``vx_mps``, ``lap_time_s``; equations use the field's symbols.
- ``base_link`` is the center of the rear axle; the state of the single-track model is at the center
  of gravity, ``l_r`` ahead of it.

References
----------
J. Becker, N. Imholz, L. Schwarzenbach, E. Ghignone, N. Baumann, M. Magno, "Model- and
Acceleration-based Pursuit Controller for High-Performance Autonomous Racing", ICRA 2023.
"""

__version__ = "0.1.0"
