from pathlib import Path

import pytest

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data():
    """Folder of real recordings, tracks and tire data, which are not part of the repository."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"the real data are not beside the repository ({SHARED_DATA.parent.name}/data)")
    return SHARED_DATA


@pytest.fixture(scope="session")
def shared_cases(shared_data):
    """Folder of small inputs of kinds that went wrong; its README has the right answers."""
    return shared_data.parent / "cases"
