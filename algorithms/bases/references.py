"""References: estimators that see the truth and give many realisations of what they make of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from isacbench.cores import one_blas_thread
from isacbench.errors import InputError
from isacbench.metrics.realisations import nearest_to_mean
from isacbench.model.cloud import PointCloud
from isacbench.model.observation import Observation
from isacbench.model.radio_coordinates import Radio
from isacbench.plugins.contracts import Needs

N_REALISATIONS = 64
"""Realisations of each reference: the standard error of a mean is an eighth of the spread or less."""


class Reference(ABC):
    """Estimator whose scores are means over realisations."""

    name: ClassVar[str]
    needs_truth: ClassVar[bool] = True
    needs: ClassVar[Needs] = Needs(elements="none", integration=None, cells="none")

    @abstractmethod
    def realisations(self, radio: Radio, truth: PointCloud) -> list[PointCloud]:
        """Make all realisations from a truth.

        Parameters
        ----------
        radio : Radio
            Scenario or observation.
        """

    @one_blas_thread()
    def estimate(self, observation: Observation, truth: PointCloud | None = None) -> PointCloud:
        """Select the realisation whose deviation is nearest to the mean deviation.

        Parameters
        ----------
        observation : Observation
            Only its system, array, frame, base station and region are used.

        Raises
        ------
        InputError
            Without a truth.
        """
        if truth is None:
            raise InputError(
                f"estimator {self.name} needs the truth: call estimate(observation, scenario.truth)"
            )
        if not len(truth):
            return PointCloud.empty()
        clouds = self.realisations(observation, truth)
        bin_mps = observation.system.velocity_bin_mps
        return clouds[nearest_to_mean(truth, clouds, observation.region, bin_mps)]
