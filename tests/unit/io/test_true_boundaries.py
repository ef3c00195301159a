"""True boundaries are read strictly: what is no number is said, not measured."""

from pathlib import Path

import numpy as np
import pytest

from mammometry.io.truth import _boundaries


def test_a_boundary_is_read(tmp_path: Path) -> None:
    (tmp_path / "boundary_patient_left.xyz").write_text("1 2 3\n4 5 6\n7 8 9.5\n")
    np.testing.assert_array_equal(_boundaries(tmp_path)["left"], [[1, 2, 3], [4, 5, 6], [7, 8, 9.5]])


@pytest.mark.parametrize("spoilt", ["1 2 inf", "1 nan 3", "1 2 1e200", "1 2"])
def test_what_is_no_point_is_refused(tmp_path: Path, spoilt: str) -> None:
    (tmp_path / "boundary_base.xyz").write_text(f"{spoilt}\n{spoilt}\n")
    with pytest.raises(ValueError, match="number"):
        _boundaries(tmp_path)
