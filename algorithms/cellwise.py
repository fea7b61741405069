"""Import path of the base class of cell-by-cell estimators, which is defined with its stages."""

from .chain import CellwiseEstimator as CellwiseEstimator
