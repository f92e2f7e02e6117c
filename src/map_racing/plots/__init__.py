"""Figures; the only package that imports matplotlib."""

import os as _os

from ..errors import MapRacingError as _MapRacingError

# Figures are written to files: do not load the user's backend, which may not exist.
_backend = _os.environ.pop("MPLBACKEND", None)
try:
    import matplotlib as _matplotlib  # noqa: F401
except (OSError, ValueError) as error:
    raise _MapRacingError(
        f"cannot load matplotlib: {error}: is a file named matplotlibrc damaged?"
    ) from None
finally:
    if _backend is not None:
        _os.environ["MPLBACKEND"] = _backend
