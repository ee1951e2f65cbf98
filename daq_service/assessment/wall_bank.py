"""Banks of wall curves (`analysis.wall.bank`): simulated with the twin, shipped with solimon, or in a cache.

A member of a bank is one kind of damage on one model of the plate. Its curve comes from noise-free shots at a
series of depths, through the extractor of the recorder. The depth of each patch is converted to the loss
averaged over the disc of the estimand. The simulator's models are imported where they are needed: without the
extra `twin`, `open_bank` still returns a stored bank.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
import platformdirs

from analysis.errors import InvalidInputError
from analysis.wall.bank import ESTIMAND_RADIUS_M, FEATURES, Bank, load_bank, save_bank
from analysis.waves.features import EXTRACTOR_VERSION, extract_from_volts
from analysis.waves.record_reduction import ExtractionSettings, FloatArray
from analysis.waves.transducer import settings_of_chain
from daq_service.acquisition.shot_features import describe_chain
from daq_service.processes.installation import require_extras
from daq_service.shared_file import write_best_effort
from simulator.chain.spheres import Contacts
from simulator.errors import SimulatorError, SpecimenError
from simulator.parameters.chain import ChainParameters
from simulator.parameters.electronics import AdcParameters, SensorParameters
from simulator.parameters.environmental_variability import STEEL_MODULUS_CHANGE_PER_K
from simulator.parameters.experiment import (
    TWIN_VERSION,
    ScatterParameters,
    ThinningParameters,
    TwinParameters,
)
from simulator.parameters.plate import (
    CorrosionParameters,
    LiquidParameters,
    PatchParameters,
    PlateParameters,
    SolidMesh,
)
from simulator.plate.mindlin import patches

if TYPE_CHECKING:
    from daq_service.settings.tree import PositionSettings
    from simulator.shot.model import Impact, ShotForce, ShotModel

log = logging.getLogger(__name__)

BANK_VERSION = "2"
"""Changes whenever the members or their curves would; then the shipped bank is written again."""
SHIPPED_BANK: Final = Path(__file__).with_name("wall_bank.npz")
"""Bank of the shipped configurations: `python benchmarks/diagnosis_slopes.py --bank FILE` writes it."""
DEFAULT_FOLDER: Final = platformdirs.user_cache_path("solimon", appauthor=False) / "wall_banks"

LOSSES: Final = np.linspace(0.0, 0.9, 181)
DEPTHS: Final = np.linspace(0.0, 0.95, 39)
"""Simulated depths of a patch; a cubic spline connects them."""
SIZES_M: Final = (15e-3, 17.5e-3, 20e-3, 22.5e-3, 25.4e-3, 29e-3, 33e-3, 38e-3, 44e-3, 50.8e-3, 60e-3, 70e-3)
FEWER_SIZES_M: Final = (*SIZES_M[::2], 50.8e-3, 70e-3)
PAPER_SIZES_M: Final = (25.4e-3, 50.8e-3)
FEWEST_DEPTHS = 4
LIQUID_DEPTH_M = 0.05
"""Of the wet members, unless the plate has a liquid; above some centimeters it does not matter."""

PHASES = 8
"""Records with the sample clock at different phases, averaged."""
LOG_STEP, KELVIN_STEP, TILT_STEP_RAD = 0.02, 10.0, 0.004
MEAN_TILT_RAD = ScatterParameters().mean_tilt_rad


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseFreeRecorder:
    """Sensor, digitizer and extractor, without noise and quantization; a voltage is in N without tilt."""

    adc: AdcParameters = field(default_factory=AdcParameters)
    extraction: ExtractionSettings = field(default_factory=ExtractionSettings)
    tilt_loss_per_rad: float = SensorParameters().tilt_loss_per_rad
    waves: tuple[tuple[str, float], ...] = ()
    """Keys of ``[positions.NAME.waves]`` that have priority over what follows from the chain, and values."""
    names: tuple[str, ...] = FEATURES

    def for_chain(self, chain: ChainParameters) -> NoiseFreeRecorder:
        """Return the recorder with the extraction of a chain."""
        return replace(self, extraction=settings_of_chain(describe_chain(chain), **dict(self.waves)))

    def log_features(self, force: ShotForce, tilt_rad: float = MEAN_TILT_RAD) -> FloatArray:
        """Return the logarithms of the named features of a shot; NaN without a reflected wave."""
        rate_hz, before = self.adc.sample_rate_hz, self.adc.pretrigger_samples
        step_s = float(force.time_s[-1]) / (force.time_s.size - 1)
        grid_s = np.arange(force.time_s.size) * step_s
        signal_v = math.exp(-self.tilt_loss_per_rad * tilt_rad) * (force.force_n - force.preload_n)
        logs = []
        for phase in np.arange(PHASES) / PHASES - 1.0:
            sampled_s = (phase + np.arange(-before, self.adc.record_samples)) / rate_hz
            volts = np.interp(sampled_s, grid_s, signal_v, left=0.0)
            # Where the chain has let go of the sensor, equal samples would look like lost ones.
            equal = np.flatnonzero(np.diff(volts[before:]) == 0.0) + before
            volts[equal] *= 1.0 + 1e-9 * (equal % 2)
            shot = extract_from_volts(volts, rate_hz, before, settings=self.extraction)
            # Flags do not count: next to no noise at all, every ripple looks like a disturbance.
            logs.append([math.log(getattr(shot, name)) for name in self.names])
        return np.asarray(np.mean(logs, axis=0))


RECORDER = NoiseFreeRecorder()
Kind = tuple[ChainParameters, PlateParameters, NoiseFreeRecorder]
"""Arguments of `open_bank` and `build_bank`."""


def list_bank_arguments(place: PositionSettings) -> Kind:
    """Return what determines the bank of a position."""
    # Without flags, the allowed pull moves no curve.
    waves = place.waves.model_dump(exclude_none=True, exclude={"deepest_pull_fraction"})
    return place.chain, place.plate, replace(RECORDER, waves=tuple(sorted(waves.items())))


@dataclass(frozen=True, slots=True)
class Member:
    """Damage and model of one curve; factors of the dashpots (chain, plate) and of the tilt."""

    model: str
    kind: str
    name: str
    plate: PlateParameters
    patch: CorrosionParameters
    size_m: float
    damping_factor: float = 1.0
    contact_damping_factor: float = 1.0
    tilt_factor: float = 1.0


def compute_mean_loss(patch: CorrosionParameters, radius_m: float = ESTIMAND_RADIUS_M) -> float:
    """Return the loss averaged over a disc around the contact, per depth of the patch (0 to 1)."""
    grid_m = np.linspace(-radius_m, radius_m, 401)
    x_m, y_m = (
        np.unique(np.concatenate([grid_m, np.clip(lines, -radius_m, radius_m)]))
        for lines in patches.list_patch_lines(patch, 0.0)
    )
    middle_x_m, middle_y_m = 0.5 * (x_m[1:] + x_m[:-1])[:, None], 0.5 * (y_m[1:] + y_m[:-1])
    disc = PatchParameters(shape="round", size_m=2.0 * radius_m)
    area = patches.patch_fraction(x_m, y_m, disc) * np.outer(np.diff(x_m), np.diff(y_m))
    loss = np.zeros_like(area)
    for one in patch.patches:
        if one.profile == "flat":
            depth = patches.patch_fraction(x_m, y_m, one)
        else:
            depth = patches.evaluate_profile_depth(middle_x_m, middle_y_m, one)
        loss += one.depth_factor * depth
    return float((area * loss).sum() / area.sum())


def list_members(plate: PlateParameters) -> list[Member]:
    """List the members of a bank whose patches fit on the plate, in its order."""
    fitting = []
    for member in _yield_members(plate):
        with suppress(SpecimenError):
            patches.check_patches(member.plate, member.patch)
            fitting.append(member)
    return fitting


def _yield_members(plate: PlateParameters) -> Iterator[Member]:
    """Yield all members; those on the same plate and patch follow each other."""
    node = replace(plate, model="mindlin", contact="node", liquid=None)
    element_m = min(node.contact_element_m, node.contact_radius_m)
    circle = replace(node, contact="patch", contact_element_m=element_m)
    wet = replace(node, liquid=plate.liquid or LiquidParameters(depth_m=LIQUID_DEPTH_M))
    # The solid plate has its contact in the middle and its edges held.
    solid = replace(node, model="solid", solid=SolidMesh(one_basis=True), contact_x_m=0.0, contact_y_m=0.0)
    if solid.support == "free":
        solid = replace(solid, support="simply_supported")

    def make(
        kind: str, patch: CorrosionParameters, detail: str = "", on: PlateParameters = node, *factors: float
    ) -> Member:
        """Return a member with its name; the factors are those of `Member`, 1 if there are none."""
        model = "mindlin_circle" if on is circle else "wet_mindlin" if on is wet else on.model
        size_m = round(patch.size_m * math.isqrt(len(patch.patches)), 6)  # of a mosaic the complete edge
        name = f"{model.replace('_', ' ')}, {patch.shape} {1e3 * size_m:.4g} mm"
        return Member(model, kind, f"{name}, {detail}" if detail else name, on, patch, size_m, *factors)

    for size in SIZES_M:
        square = CorrosionParameters(size_m=size)
        round_patch = replace(square, shape="round")
        yield make("nominal" if size in PAPER_SIZES_M else "size", square)
        if size in PAPER_SIZES_M:
            for tilt in (0.0, 2.0):
                yield make("tilt", square, f"tilt x {tilt:g}", node, 1.0, 1.0, tilt)
        if size in FEWER_SIZES_M:
            for factor in (0.5, 2.0):
                yield make("dashpot", square, f"dashpots of the chain x {factor:g}", node, factor)
                yield make("dashpot", square, f"dashpot at the plate x {factor:g}", node, 1.0, factor)
            yield make("contact", square, on=circle)
            yield make("wet", square, on=wet)
            yield make("round", round_patch)
            yield make("bowl", replace(round_patch, profile="bowl"), "bowl")
            yield make("cosine", replace(round_patch, profile="cosine"), "cosine")
            for x, y in ((0.25, 0.0), (0.4, 0.4)):
                off = replace(square, offset_x_m=x * size, offset_y_m=y * size)
                yield make("off_centre", off, f"off center by {x:g} and {y:g} of its size")
            for per_edge in (3, 5):
                yield make("pits", _divide_into_pits(square, per_edge), f"{per_edge} x {per_edge} pits")
        yield make("solid", round_patch, on=solid)
        yield make("solid", square, on=solid)
    for size, size_y in ((15e-3, 30e-3), (20e-3, 60e-3), (30e-3, 60e-3)):
        oblong = CorrosionParameters(shape="rectangular", size_m=size, size_y_m=size_y)
        yield make("solid", oblong, f"{1e3 * size_y:g} mm long", solid)


def _divide_into_pits(patch: CorrosionParameters, per_edge: int) -> CorrosionParameters:
    """Return a square patch as a mosaic of pits, the deepest one below the chain."""
    from simulator.experiment.corrosion import make_patch

    pitted = ThinningParameters(pits_per_edge=per_edge)  # type: ignore[arg-type] # 3 or 5
    name = f"{patch.size_m} m, {per_edge}"  # it determines the depths of the pits
    return make_patch(TwinParameters(thinning={name: pitted}), name, patch)


def compute_source_slopes(
    chain: ChainParameters, plate: PlateParameters, recorder: NoiseFreeRecorder
) -> dict[str, FloatArray]:
    """Compute the change of the recorder's log features by one unit of each source, on the sound wall.

    A unit is one of ln (stiffness and dashpot of each contact, drop height, modulus of the plate), a radian
    of tilt, or a kelvin of chain and plate (`modulus_k`, by their moduli).
    """
    from simulator.shot.model import Impact, ShotModel

    model = ShotModel(chain, plate, CorrosionParameters(), cache_folder=None)
    everywhere = np.ones(chain.bodies)

    def compute_slope(step: float, where: FloatArray = everywhere, **unit: float) -> FloatArray:
        """Return the central difference; a step moves each source by its unit, at the contacts `where`."""
        logs = []
        for signed in (step, -step):
            by = {name: signed * size for name, size in unit.items()}
            tilt_rad = chain.tilt_rad + MEAN_TILT_RAD + by.get("tilt", 0.0)
            impact = Impact(
                drop_height_m=chain.drop_height_m * math.exp(by.get("drop", 0.0)),
                tilt_rad=tilt_rad,
                contacts=Contacts(
                    stiffness_factor=np.exp(by.get("stiffness", 0.0) * where),
                    damping_factor=np.exp(by.get("damping", 0.0) * where),
                ),
                plate_modulus_factor=math.exp(by.get("modulus", 0.0)),
            )
            logs.append(recorder.log_features(model.shots([impact])[0], tilt_rad))
        return np.asarray((logs[0] - logs[1]) / (2.0 * step))

    kelvin = math.log1p(STEEL_MODULUS_CHANGE_PER_K * KELVIN_STEP) / KELVIN_STEP
    found = {}
    for contact, where in enumerate(np.eye(chain.bodies)):
        found[f"stiffness_{contact}"] = compute_slope(LOG_STEP, where, stiffness=1.0)
        found[f"damping_{contact}"] = compute_slope(LOG_STEP, where, damping=1.0)
    found["drop_height"] = compute_slope(LOG_STEP, drop=1.0)
    found["tilt_rad"] = compute_slope(TILT_STEP_RAD, tilt=1.0)
    found["plate_modulus"] = compute_slope(LOG_STEP, modulus=1.0)
    found["modulus_k"] = compute_slope(KELVIN_STEP, stiffness=kelvin, modulus=kelvin)
    return found


def make_impact(chain: ChainParameters, member: Member, depth_fraction: float) -> Impact:
    """Return the impact of a member at a depth of its patch."""
    from simulator.shot.model import Impact

    damping = np.full(chain.bodies, member.damping_factor)
    damping[-1] = member.contact_damping_factor
    return Impact(
        depth_fraction=depth_fraction,
        tilt_rad=chain.tilt_rad + member.tilt_factor * MEAN_TILT_RAD,
        contacts=Contacts(stiffness_factor=np.ones(chain.bodies), damping_factor=damping),
    )


def _simulate_curve(
    chain: ChainParameters, member: Member, model: ShotModel, recorder: NoiseFreeRecorder
) -> FloatArray:
    """Simulate the change of the log features of a member at `LOSSES`, shape (n_losses, 5).

    The curve ends, with NaN, at the first depth that the twin does not simulate, or without a reflected wave,
    or where the time of flight stops growing: then the extractor takes another wave.
    """
    from scipy.interpolate import CubicSpline

    logs: list[FloatArray] = []
    try:
        for depth in DEPTHS.tolist():
            impact = make_impact(chain, member, depth)
            found = recorder.log_features(model.shots([impact])[0], impact.tilt_rad or 0.0)
            if not np.isfinite(found).all():
                break
            logs.append(found)
    except SimulatorError:  # a curve may end where the twin does
        if len(logs) < FEWEST_DEPTHS:
            raise
    if len(logs) < FEWEST_DEPTHS:
        raise InvalidInputError(
            f"{member.name}: the twin's reflected wave is found at {len(logs)} depths, a curve needs "
            f"{FEWEST_DEPTHS}. Look at a shot of this chain with `solimon simulate`"
        )
    losses = DEPTHS[: len(logs)] * compute_mean_loss(member.patch)
    curve = CubicSpline(losses, logs, extrapolate=False)(LOSSES)
    rises = np.append(True, np.diff(curve[:, 0]) > 0.0)
    curve[~np.logical_and.accumulate(rises)] = np.nan
    return np.asarray(curve - curve[0])


def compute_digest(chain: ChainParameters, plate: PlateParameters, recorder: NoiseFreeRecorder) -> str:
    """Return the SHA-256 (hex) of all that determines a bank; model and contact law of the plate do not."""
    adc = recorder.adc
    described = {
        "chain": asdict(chain, dict_factory=_leave_strengths_out),
        "plate": asdict(
            replace(plate, model="mindlin", contact="node", solid=SolidMesh()),
            dict_factory=_leave_strengths_out,
        ),
        "sensor": recorder.tilt_loss_per_rad,
        "digitizer": (adc.sample_rate_hz, adc.record_samples, adc.pretrigger_samples),
        "versions": (TWIN_VERSION, EXTRACTOR_VERSION, BANK_VERSION),
    } | ({"waves": recorder.waves} if recorder.waves else {})
    return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()


def _leave_strengths_out(items: list[tuple[str, object]]) -> dict[str, object]:
    """Return the fields of a dataclass without its yield strength, which moves no wave."""
    return {name: value for name, value in items if name != "yield_strength_pa"}


def build_bank(
    chain: ChainParameters,
    plate: PlateParameters,
    recorder: NoiseFreeRecorder = RECORDER,
    *,
    members: Sequence[Member] | None = None,
    progress: Callable[[int, int, str], None] = lambda done, total, name: None,
) -> Bank:
    """Simulate a bank: about 6 minutes of CPU, in one thread.

    Parameters
    ----------
    members
        Some of `list_members`; None: all of them.
    progress
        Called before each member with its index, the number of members and its name; an exception that it
        raises ends the work.

    Raises
    ------
    MissingExtraError
        The extra `twin` is not installed.
    InvalidInputError
        The extractor finds no reflected wave on the sound wall, or no patch fits.
    SimulatorError
        The twin does not simulate such a chain or plate.
    """
    require_extras("twin")
    from simulator.shot.model import Impact, ShotModel

    members, recorder = list_members(plate) if members is None else members, recorder.for_chain(chain)
    nominal = replace(plate, model="mindlin", contact="node", liquid=None)
    slopes = compute_source_slopes(chain, nominal, recorder)
    sound = recorder.log_features(
        ShotModel(chain, nominal, CorrosionParameters(), cache_folder=None).shots([Impact()])[0]
    )
    del slopes["plate_modulus"]  # temperature moves it, with the moduli of the chain
    slopes["gain"] = np.array([float(name.endswith("_v")) for name in FEATURES])
    changes, known = [], None
    for index, member in enumerate(members):
        progress(index, len(members), member.name)
        if (member.plate, member.patch) != known:
            known = member.plate, member.patch
            model = ShotModel(chain, *known, cache_folder=None)  # each is needed once only
        changes.append(_simulate_curve(chain, member, model, recorder))
    return Bank(
        losses=LOSSES,
        changes=np.array(changes, dtype=np.float32),
        models=tuple(member.model for member in members),
        kinds=tuple(member.kind for member in members),
        sizes_m=np.array([member.size_m for member in members]),
        names=tuple(member.name for member in members),
        sound=sound,
        slopes=np.array(list(slopes.values()), dtype=np.float32),
        sources=tuple(slopes),
        thickness_m=plate.thickness_m,
        digest=compute_digest(chain, plate, recorder),
    )


def open_bank(
    chain: ChainParameters,
    plate: PlateParameters,
    recorder: NoiseFreeRecorder = RECORDER,
    *,
    folder: Path = DEFAULT_FOLDER,
) -> Bank | None:
    """Return the bank that is shipped or stored for these parameters; None: it must be built.

    A corrupt file is logged.
    """
    digest = compute_digest(chain, plate, recorder)
    for file in (SHIPPED_BANK, folder / f"{digest}.npz"):
        try:
            bank = load_bank(file)
        except FileNotFoundError:
            continue
        except (OSError, InvalidInputError) as error:
            log.warning("cannot use the stored wall bank: %s", error)
            continue
        if bank.digest == digest:
            return bank
    return None


def store_bank(bank: Bank, folder: Path = DEFAULT_FOLDER) -> None:
    """Store a bank in the cache folder under its digest; log a failure."""
    content, path = io.BytesIO(), folder / f"{bank.digest}.npz"
    save_bank(bank, content)
    with suppress(OSError):  # writing reports it
        folder.mkdir(parents=True, exist_ok=True)
    if error := write_best_effort(path, content.getvalue()):
        log.warning("cannot store the wall bank %s (%s); it is built again next time", path, error)
