"""Parameters of the families of generated scenes, with the values that they may have."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from isacbench.choices import Mimo

MOST_SEED = 2**53
Seed = Annotated[int, Field(strict=True, ge=0, le=MOST_SEED)]
Count = Annotated[int, Field(strict=True, ge=0, le=1000)]


class FamilyParameters(BaseModel):
    """Parameters of every family.

    Attributes
    ----------
    seed : int
        Seed of the objects. Those below 500 are for developing estimators,
        500 to 999 for validating, 1000 and up for reporting.
    frame : {"panel", "paper"}
        Frame of the array.
    coherent_phase : bool
        True if every echo has the carrier's phase, false if all are in phase.
    gain_error_db, phase_error_deg : float
        Standard deviations of the gain and phase errors of the virtual elements.
    mimo : {"ideal", "comb", "tdm"}
        How the transmitters are separated.
    leakage_db : float or None
        Power of the direct path from the transmitters over that of all echoes.
    visible : {"all", "seen"}
        Scatterers of transparent objects, or those that the base station sees past all surfaces.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    seed: Seed
    frame: Literal["panel", "paper"] = "panel"
    coherent_phase: Annotated[bool, Field(strict=True)] = False
    gain_error_db: Annotated[float, Field(strict=True, ge=0, le=10, allow_inf_nan=False)] = 0.0
    phase_error_deg: Annotated[float, Field(strict=True, ge=0, le=180, allow_inf_nan=False)] = 0.0
    mimo: Mimo = "ideal"
    leakage_db: Annotated[
        Annotated[float, Field(strict=True, ge=-200, le=200)] | None,
        BeforeValidator(lambda value: None if value == "none" else value),
    ] = None
    visible: Literal["all", "seen"] = "all"


class DensityParameters(FamilyParameters):
    """Parameters of a family of mixed objects.

    Attributes
    ----------
    density : {"low", "medium", "high"}
        Number of objects.
    """

    density: Literal["low", "medium", "high"] = "medium"


class WeakParameters(DensityParameters):
    """Parameters of the family ``weak``.

    Attributes
    ----------
    dynamic_range_db : float
        Range of the powers of objects.
    """

    dynamic_range_db: Annotated[float, Field(strict=True, ge=0, le=60, allow_inf_nan=False)] = 40.0


class CrowdParameters(FamilyParameters):
    """Parameters of the family ``crowd``.

    Attributes
    ----------
    pedestrians : int
        Number of pedestrians; 0 draws 8 to 16.
    """

    pedestrians: Count = 0


class TrafficParameters(FamilyParameters):
    """Parameters of the families ``traffic`` and ``crossing``, whose objects hide each other by default."""

    visible: Literal["all", "seen"] = "seen"


class SparseParameters(FamilyParameters):
    """Parameters of the family ``sparse``.

    Attributes
    ----------
    scatterers : int
        Number of lone scatterers; 0 draws 1 to 20.
    """

    scatterers: Annotated[Count, Field(le=200)] = 0
