"""Bank of curves: change of the logarithms of the features over wall loss, for many kinds of damage.

The loss of every curve is the same quantity, the estimand: the loss of thickness since the baseline,
averaged over a disc of `ESTIMAND_RADIUS_M` around the contact. It is a fraction of the sound thickness. The
depth of a single pit is not estimated. The curves are simulated by `daq_service.assessment.wall_bank`.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import IO, Final

import numpy as np

from analysis.errors import InvalidInputError
from analysis.waves.record_reduction import FloatArray

ESTIMAND_RADIUS_M: Final = 0.010
"""Radius of the disc around the contact over which the loss is averaged."""
ESTIMAND: Final = (
    f"mean over a disc of {1e3 * ESTIMAND_RADIUS_M:.0f} mm radius around the contact, lost since the baseline"
)
FEATURES: Final = ("tof_pp_s", "amplitude_ratio", "psw_isw_area_ratio", "isw_fwhm_s", "isw_amplitude_v")
"""Features of a set, in the order of the last axis of `Bank.changes` and `Bank.slopes`."""
FORMAT: Final = "solimon wall bank 1"
"""Marks the files; another number means other arrays."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bank:
    """Curves of one chain on one plate; all arrays are read-only.

    Attributes
    ----------
    losses
        Loss of the estimand as a fraction of the sound thickness, shape (n_losses,): from 0, increasing.
    changes
        Change of the logarithms of `FEATURES` from the sound wall, shape (n_members, n_losses, 5). NaN above
        the loss that a member reaches.
    models
        Model of each member: "mindlin", "mindlin_circle", "wet_mindlin" or "solid".
    kinds
        What each member varies: "nominal", "size", "contact", "pits" and others.
    sizes_m
        Edge or diameter of the patch of each member, shape (n_members,).
    names
        Description of each member for people.
    sound
        Logarithms of `FEATURES` of the sound wall, in SI units but with the amplitude in N, shape (5,).
    slopes
        Change of the logarithms of `FEATURES` by one unit of each healthy source, shape (n_sources, 5).
    sources
        Names of the healthy sources: contacts, drop height, tilt in rad, gain, temperature in K.
    thickness_m
        Sound thickness of the plate.
    digest
        Hash of the parameters of chain, plate, sensor and digitizer.

    Raises
    ------
    InvalidInputError
        Shapes or values that contradict this description.
    """

    losses: FloatArray
    changes: FloatArray
    models: tuple[str, ...]
    kinds: tuple[str, ...]
    sizes_m: FloatArray
    names: tuple[str, ...]
    sound: FloatArray
    slopes: FloatArray
    sources: tuple[str, ...]
    thickness_m: float
    digest: str

    def __post_init__(self) -> None:
        """Copy the arrays, make them read-only and check them; raise InvalidInputError."""
        for name in ("losses", "changes", "sizes_m", "sound", "slopes"):
            values = np.array(getattr(self, name), dtype=np.float64)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        members = len(self.names)
        expected = {
            "losses": (self.losses.size,),
            "changes": (members, self.losses.size, len(FEATURES)),
            "sizes_m": (members,),
            "sound": (len(FEATURES),),
            "slopes": (len(self.sources), len(FEATURES)),
        }
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise InvalidInputError(
                    f"{name} of a wall bank has shape {getattr(self, name).shape}; {shape} is needed"
                )
        if not len(self.models) == len(self.kinds) == members > 0:
            raise InvalidInputError(
                f"a wall bank has {len(self.models)} models, {len(self.kinds)} kinds and {members} names; it "
                "needs one of each for every member"
            )
        if self.losses.size < 2 or self.losses[0] != 0.0 or not np.all(np.diff(self.losses) > 0.0):
            raise InvalidInputError("losses of a wall bank must start with 0 and increase")
        if np.any(self.changes[:, 0] != 0.0) or not np.all(np.isfinite(self.slopes)):
            raise InvalidInputError("changes of a wall bank must be 0 at loss 0, and its slopes finite")


def save_bank(bank: Bank, file: Path | IO[bytes]) -> None:
    """Write a bank as a compressed npz file; curves and slopes are rounded to float32."""
    arrays = {field.name: np.asarray(getattr(bank, field.name)) for field in fields(Bank)}
    for name in ("changes", "slopes"):
        arrays[name] = arrays[name].astype(np.float32)
    np.savez_compressed(file, format=np.asarray(FORMAT), **arrays)  # type: ignore[arg-type] # numpy reads them as its options


def load_bank(file: Path | IO[bytes]) -> Bank:
    """Read a bank that `save_bank` wrote.

    Raises
    ------
    InvalidInputError
        The file is corrupt, or no bank of this version.
    OSError
        The file cannot be read.
    """
    content = file.read_bytes() if isinstance(file, Path) else file.read()
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as stored:
            found = dict(stored)
        if str(found.pop("format")) != FORMAT:
            raise InvalidInputError("another format")
        for name in ("models", "kinds", "names", "sources"):
            found[name] = tuple(map(str, found[name]))
        return Bank(**found | {"thickness_m": float(found["thickness_m"]), "digest": str(found["digest"])})
    except (ValueError, KeyError, TypeError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise InvalidInputError(
            f"{file} is no intact wall bank of this version ({error}). Delete it, so that it is built again"
        ) from error
