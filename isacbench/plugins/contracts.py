"""Contracts between the harness and its plugins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import (
    TYPE_CHECKING,
    ClassVar,
    Literal,
    Protocol,
    TypeGuard,
    get_args,
    get_type_hints,
    runtime_checkable,
)

from isacbench.display import short_repr
from isacbench.dsp.detection import Detection as Detection
from isacbench.dsp.detection import Detector as Detector
from isacbench.errors import require
from isacbench.metrics.descriptions import ScoreColumn as ScoreColumn
from isacbench.process_state import plugin_output

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from isacbench.metrics.geometry import CloudPair
    from isacbench.model.cloud import PointCloud
    from isacbench.model.observation import Observation
    from isacbench.model.radio_coordinates import Radio as Radio


@dataclass(frozen=True)
class Needs:
    """Parts of an observation that an estimator reads; nothing else is computed for it.

    Attributes
    ----------
    elements : {"plane", "cross", "none"}
        All P Q virtual elements (`Observation.cells`), the P + Q - 1 of one
        column and one row (`Observation.cross`), or no echo at all.
    integration : {"beams", "noncoherent", "element"} or None
        What its detection tests in a cell: the strongest of the beams towards the
        region, the mean power of all elements that it reads, or the power of one.
        None where it detects on no map.
    cells : {"gate", "detected", "none"}
        Range-Doppler cells whose directions it looks into.

    Raises
    ------
    InputError
        If a value is not allowed.
    """

    elements: Literal["plane", "cross", "none"] = "plane"
    integration: Literal["beams", "noncoherent", "element", None] = "noncoherent"
    cells: Literal["gate", "detected", "none"] = "gate"

    def __post_init__(self) -> None:
        for name, allowed in _OPTIONS_OF_NEEDS.items():
            value = getattr(self, name)
            require(value in allowed, f"needs.{name}", value, f"one of {', '.join(map(str, allowed))}")


_OPTIONS_OF_NEEDS = {name: get_args(hint) for name, hint in get_type_hints(Needs).items()}


@runtime_checkable
class Estimator(Protocol):
    """An imaging algorithm: a frozen dataclass of its parameters.

    It knows the observation and nothing else: no truth, no SNR, no noise
    power. It must not write to the observation's arrays.

    It may have an attribute or property ``needs``, a `Needs`; one without is
    taken to read everything (`needs_of`).
    """

    name: ClassVar[str]

    def estimate(self, observation: Observation) -> PointCloud:
        """Image one observation."""


@runtime_checkable
class TruthEstimator(Estimator, Protocol):
    """An estimator that sees the truth: a bound, never a competitor.

    Without the truth it raises `isacbench.errors.InputError`.
    """

    needs_truth: ClassVar[bool]

    def estimate(self, observation: Observation, truth: PointCloud | None = None) -> PointCloud:
        """Image one observation, knowing its truth."""


@runtime_checkable
class ReferenceEstimator(TruthEstimator, Protocol):
    """An estimator that sees the truth and gives many clouds, over which scores are averaged.

    Its ``estimate`` returns the realisation whose deviation is nearest to the mean.
    """

    def realisations(self, radio: Radio, truth: PointCloud) -> Sequence[PointCloud]:
        """Make all realisations, at least one, from a truth; the same in every call.

        Parameters
        ----------
        radio : Radio
            Scenario or observation.
        truth : PointCloud
        """


@runtime_checkable
class Metric(Protocol):
    """A measure of images: a frozen dataclass of its parameters, and the columns that it fills.

    It may have a class attribute ``version``, a whole number, which is counted up when the same image
    gets other scores than before; without one the version is 1. It may have a method ``lacks(scenario)``
    that says in a text what a scenario lacks for it, empty if nothing: its scores are then NaN. They are also
    NaN for scenes without scatterers, unless a class attribute ``scores_empty_truth`` is true.
    """

    name: ClassVar[str]
    columns: ClassVar[tuple[ScoreColumn, ...]]

    def score(self, pair: CloudPair) -> Mapping[str, float]:
        """Score an image against its truth.

        The order of points must not matter. An image without points is scored like any other.

        Parameters
        ----------
        pair : CloudPair
            Truth, estimate, region, radius, and the scenario if it is known.

        Returns
        -------
        mapping of str to float
            A number for each column; NaN where it has no value. A column ``detected_*`` stands for one of
            each kind of object that the scenario has.
        """


@dataclass(frozen=True, eq=False)
class Spectrum:
    """An angular spectrum of one range-Doppler cell, along one direction cosine.

    Attributes
    ----------
    cosine : ndarray of float64, shape (g,)
        Direction cosines, ascending.
    level_db : ndarray of float64, shape (g,)
        Level of the spectrum in dB; the estimator chooses its zero.
    threshold_db : float, ndarray of float64 of shape (g,), or None
        Level that a peak has to exceed; None where the estimator has no threshold.
    peaks : ndarray of float64, shape (k,)
        Direction cosines that the estimator takes for echoes.
    label : {"u", "w"}
        The direction cosine that the spectrum runs along.
    """

    cosine: NDArray[np.float64]
    level_db: NDArray[np.float64]
    threshold_db: float | NDArray[np.float64] | None
    peaks: NDArray[np.float64]
    label: Literal["u", "w"]

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Intermediate results of an estimator: its range-Doppler map, detections and spectra.

    Attributes
    ----------
    power : ndarray of float64, shape (n_range, n_doppler)
        Power of the map that was detected on.
    detection : Detection
        Detections in that map.
    range_bins : ndarray of int64, shape (n_range,)
        Range bins of the map.
    doppler_bins : ndarray of int64, shape (n_doppler,)
        Signed Doppler bins of the map.
    spectra : tuple of Spectrum
        Spectra of the strongest detected cell, empty where nothing was detected.
    cell : (int, int) or None
        Range and Doppler bin of that cell, None where nothing was detected.
    separated : bool or None
        True if signal and noise subspaces of that cell are separated, so that
        their directions are more than rounding; None where there are none.
    """

    power: NDArray[np.float64]
    detection: Detection
    range_bins: NDArray[np.int64]
    doppler_bins: NDArray[np.int64]
    spectra: tuple[Spectrum, ...]
    cell: tuple[int, int] | None
    separated: bool | None = None

    __repr__ = short_repr


@runtime_checkable
class Diagnoser(Protocol):
    """Estimator that shows its intermediate results. Optional: figures of maps and spectra need it."""

    def diagnose(self, observation: Observation) -> Diagnosis:
        """Process one observation as `Estimator.estimate` does, and keep intermediate results."""


def is_reference(plugin: object) -> TypeGuard[ReferenceEstimator]:
    """Tell whether a plugin sees the truth and has realisations."""
    return isinstance(plugin, ReferenceEstimator) and plugin.needs_truth


@plugin_output()
def needs_of(estimator: Estimator) -> Needs:
    """Look up the needs of an estimator: all of the gate on all elements where it declares nothing."""
    needs = getattr(estimator, "needs", Needs())
    if not isinstance(needs, Needs):
        raise TypeError(f"estimator {estimator.name}: its needs must be a Needs, not {type(needs).__name__}")
    return needs
