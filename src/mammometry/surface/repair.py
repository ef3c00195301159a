"""Elastic repair of the first surface towards the valid range data (paper 2.6.3)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from mammometry.geometry.arrays import Array, Float32, Float64, Int32, UInt8, read_only
from mammometry.geometry.mesh import TriangleMesh


class Provenance(IntEnum):
    """Where a vertex comes from."""

    INVENTED = 0
    """Nothing was seen there: closed plainly."""
    REPAIRED = 1
    """No range datum of its own; carried along by its neighbours and bounded by silhouettes."""
    MEASURED = 2
    """Drawn to range data of at least one pair."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairSettings:
    """Elastic moduli, correspondence gates and iteration."""

    rho: float = 1.0
    """Weight ρ of the internal energy (Eq. 4), dimensionless; 10 was worse by a tenth."""
    k_ext: float = 1.0
    """External modulus (Eq. 5), dimensionless."""
    k_int: float = 1.0
    """Internal modulus (Eq. 6), dimensionless."""
    rounds: int = 2
    """Number of correspond-and-solve rounds at most; a round also ends the loop when displacements stop shrinking."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RepairedSurface:
    """The repaired mesh and where each of its vertices comes from."""

    mesh: TriangleMesh
    """Same faces as the first surface; world frame, mm."""
    provenance: UInt8[Array, " n"]
    """`Provenance` of each vertex."""
    sigma_mm: Float32[Array, " n"]
    """Expected standard deviation along the normal of a measured vertex, mm; NaN where not measured."""
    pair_bits: Int32[Array, " n"]
    """Bit k set: pair `pair_names[k]` measured this vertex."""
    pair_names: tuple[str, ...]
    """The pairs that the bits stand for, in order."""
    convergence: Float64[Array, " rounds"]
    """RMS movement of the vertices in each round, mm."""

    def __post_init__(self) -> None:
        for field in ("provenance", "sigma_mm", "pair_bits", "convergence"):
            object.__setattr__(self, field, read_only(getattr(self, field)))
        n = len(self.mesh.vertices)
        if not len(self.provenance) == len(self.sigma_mm) == len(self.pair_bits) == n:
            raise ValueError(f"one provenance, sigma and pair set per vertex expected, mesh has {n}")
