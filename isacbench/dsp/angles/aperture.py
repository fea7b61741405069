"""Virtual elements that are read, a plane or a cross of two lines, and their responses to directions.

The response to a plane wave is a line of phases along u times one along w. So
the products of responses over the P x Q elements of a plane are those over a
column times those over a row. Over a cross, one column and one row of P + Q - 1
elements, they are their sum.

Snapshots end in the axes of the elements: (P, Q) of a plane, (P + Q - 1,) of a
cross, in the order of `isacbench.model.observation.cross_of`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from isacbench.checked_arrays import Complex, Floats
from isacbench.model.kernels import steering


class Responses(ABC):
    """Responses of the elements to plane waves, from direction cosines u and w apart.

    Attributes
    ----------
    along_u : ndarray of complex128, shape (..., i, P)
        Phases along the column, of i cosines u.
    along_w : ndarray of complex128, shape (..., j, Q), or (..., j, Q - 1) of a cross
        Phases along the row, of j cosines w; on a cross without the element
        that it shares with the column.
    n_elements : int
        Elements over which products are averaged.
    """

    first_of_row = 0
    other_line = 1.0
    _joined: ClassVar[np.ufunc] = np.multiply

    def __init__(self, aperture: Aperture, u: Floats, w: Floats) -> None:
        self.u, self.w = u, w
        self.along_u = steering(aperture.n_p, u)
        self.along_w = steering(aperture.n_q, w)[..., self.first_of_row :]
        self.n_elements = aperture.n_elements

    def gram(self) -> Complex:
        """Outputs of filters matched to k directions, for unit waves from each of them.

        Returns
        -------
        ndarray of complex128, shape (..., k, k)
            Hermitian, filters first; 1 on the diagonal.
        """
        return self._mean_products(*_line_grams(self.along_u, self.along_w))

    def intersections_gram(self) -> Complex:
        """The same of all pairs of one of the i cosines u and one of the j cosines w.

        Returns
        -------
        ndarray of complex128, shape (n, i, j, i, j)
        """
        along_u, along_w = _line_grams(self.along_u, self.along_w)
        return self._mean_products(along_u[:, :, None, :, None], along_w[:, None, :, None, :])

    def slope_gram(self) -> Complex:
        """Mean products over the elements of k responses, their slopes along u, and their slopes along w.

        Returns
        -------
        ndarray of complex128, shape (..., 3 k, 3 k)
            Hermitian; slopes per Rayleigh cell of the array, 2/P in u and 2/Q in w.
        """
        a, b = self.along_u, self.along_w
        p, q = np.arange(a.shape[-1]), np.arange(b.shape[-1]) + self.first_of_row
        along_u = np.concatenate([a, -2j * np.pi / p.size * p * a, self.other_line * a], axis=-2)
        along_w = np.concatenate([b, self.other_line * b, -2j * np.pi / (q[-1] + 1) * q * b], axis=-2)
        return self._mean_products(*_line_grams(along_u, along_w))

    @abstractmethod
    def matched(self, snapshots: Complex) -> Complex:
        """Outputs of filters matched to k directions a cell: 1 for a unit wave from there.

        Parameters
        ----------
        snapshots : ndarray of complex, shape (s, n, *elements)

        Returns
        -------
        ndarray of complex, shape (s, n, k)
        """

    @abstractmethod
    def matched_intersections(self, snapshots: Complex) -> Complex:
        """The same, shape (n, i, j), of all pairs of one of the i cosines u and one of the j cosines w."""

    @abstractmethod
    def about_middle(self) -> tuple[Complex, NDArray[np.inexact[Any]]]:
        """Responses (n, elements) to n directions, and their Gram matrix (n, n).

        Those of a plane are referred to its middle, and so their products are real.
        """

    @abstractmethod
    def synthesis(self, amplitude: Complex) -> Complex:
        """Sum of the plane waves of amplitudes (n, k), shape (n, *elements)."""

    def _mean_products(self, along_u: Complex, along_w: Complex) -> Complex:
        """Mean products over all elements from the products over each line."""
        products: Complex = self._joined(along_u, along_w) / self.n_elements
        return products


class _PlaneResponses(Responses):
    """Responses of all P x Q elements, which are touched along one axis and then along the other."""

    def matched(self, snapshots: Complex) -> Complex:
        return np.vecdot(self.along_w, self.along_u.conj() @ snapshots) / self.n_elements

    def matched_intersections(self, snapshots: Complex) -> Complex:
        return self.along_u.conj() @ snapshots @ self.along_w.conj().transpose(0, 2, 1) / self.n_elements

    def about_middle(self) -> tuple[Complex, Floats]:
        a, b = (
            line * np.exp(0.5j * np.pi * (line.shape[1] - 1) * cosine)[:, None]
            for line, cosine in ((self.along_u, self.u), (self.along_w, self.w))
        )
        along_u, along_w = (part @ part.T for part in (a.view(np.float64), b.view(np.float64)))
        directions = (a[:, :, None] * b[:, None, :]).reshape(-1, self.n_elements)
        return directions, along_u * along_w / self.n_elements

    def synthesis(self, amplitude: Complex) -> Complex:
        return (self.along_u * amplitude[:, :, None]).transpose(0, 2, 1) @ self.along_w


class _CrossResponses(Responses):
    """Responses of one column, and of the rest of one row."""

    first_of_row = 1
    # A change of u leaves the row as it is, and one of w the column.
    other_line = 0.0
    _joined = np.add

    def matched(self, snapshots: Complex) -> Complex:
        return (self._whole().conj() @ snapshots[..., None])[..., 0] / self.n_elements

    def matched_intersections(self, snapshots: Complex) -> Complex:
        column, row = np.split(snapshots[:, :, None], [self.along_u.shape[-1]], axis=1)
        along_u, along_w = self.along_u.conj() @ column, self.along_w.conj() @ row
        return self._mean_products(along_u, along_w.transpose(0, 2, 1))

    def about_middle(self) -> tuple[Complex, Complex]:
        return self._whole(), self.gram()

    def synthesis(self, amplitude: Complex) -> Complex:
        return (amplitude[:, None, :] @ self._whole())[:, 0]

    def _whole(self) -> Complex:
        """Responses (..., elements) to directions."""
        return np.concatenate([self.along_u, self.along_w], axis=-1)


def _line_grams(a: Complex, b: Complex) -> tuple[Complex, Complex]:
    """Products of lines (..., i, P) with each other, and of lines (..., j, Q)."""
    return a.conj() @ a.swapaxes(-1, -2), b.conj() @ b.swapaxes(-1, -2)


@dataclass(frozen=True)
class Aperture(ABC):
    """Elements of a P x Q array that are read.

    Attributes
    ----------
    n_p, n_q : int
        Elements of the array along u and along w.
    """

    n_p: int
    n_q: int
    _responses: ClassVar[type[Responses]]

    @property
    @abstractmethod
    def n_elements(self) -> int:
        """Elements that are read."""

    def towards(self, u: Floats, w: Floats) -> Responses:
        """Responses to directions.

        Parameters
        ----------
        u, w : ndarray of float64
            Direction cosines: k a cell, shape (n, k), or of each of n beams,
            shape (n,). For intersections i cosines u and j cosines w a cell,
            shapes (n, i) and (n, j).
        """
        return self._responses(self, u, w)

    @abstractmethod
    def lines(self, snapshots: Complex) -> tuple[Complex, Complex]:
        """Read snapshots as lines of sensors along u, and as lines along w.

        Parameters
        ----------
        snapshots : ndarray of complex, shape (n, *elements)

        Returns
        -------
        along_u : ndarray of complex, shape (n, P, s)
            Lines of P sensors: the Q columns of a plane, or the column of a cross.
        along_w : ndarray of complex, shape (n, Q, t)
            Lines of Q sensors: the P rows of a plane, or the row of a cross.
        """


class Plane(Aperture):
    """All P x Q elements.

    Examples
    --------
    >>> Plane(16, 16).n_elements
    256
    >>> responses = Plane(16, 16).towards(np.array([0.0, 0.0625]), np.array([0.3, 0.3]))
    >>> np.abs(responses.gram()).round(3).tolist()
    [[1.0, 0.638], [0.638, 1.0]]
    """

    _responses = _PlaneResponses

    @property
    def n_elements(self) -> int:
        """Elements P Q."""
        return self.n_p * self.n_q

    def lines(self, snapshots: Complex) -> tuple[Complex, Complex]:
        """Read the Q columns of snapshots, and their P rows."""
        return snapshots, snapshots.transpose(0, 2, 1)


class Cross(Aperture):
    """One column and one row: the elements (p, 0), then (0, q) from q = 1.

    Directions that share u, or w, are less far apart than on the plane: one of
    the two lines sees no difference.

    Examples
    --------
    >>> Cross(16, 16).n_elements
    31
    >>> responses = Cross(16, 16).towards(np.array([0.0, 0.0625]), np.array([0.3, 0.3]))
    >>> np.abs(responses.gram()).round(3).tolist()
    [[1.0, 0.611], [0.611, 1.0]]
    """

    _responses = _CrossResponses

    @property
    def n_elements(self) -> int:
        """Elements P + Q - 1."""
        return self.n_p + self.n_q - 1

    def lines(self, snapshots: Complex) -> tuple[Complex, Complex]:
        """Read the column of snapshots, and the row."""
        row = np.concatenate([snapshots[:, :1], snapshots[:, self.n_p :]], axis=1)
        return snapshots[:, : self.n_p, None], row[:, :, None]
