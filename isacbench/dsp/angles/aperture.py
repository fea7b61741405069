"""The virtual elements that are read, and how they respond to directions: a plane, or a cross of two lines.

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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isacbench.model.kernels import steering

Floats = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]


@dataclass(frozen=True, eq=False)
class Responses(ABC):
    """How the elements respond to plane waves from directions, cosines u and w apart.

    Products with snapshots have the precision of the snapshots; products of
    responses with each other are always double.

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

    along_u: Complex
    along_w: Complex
    n_elements: int

    def gram(self) -> Complex:
        """Outputs of filters matched to k directions, for unit waves from each of them.

        Returns
        -------
        ndarray of complex128, shape (..., k, k)
            Hermitian, filters first; 1 on the diagonal.
        """
        return self._joined(*self._line_products())

    def intersections_gram(self) -> Complex:
        """The same of all pairs of one of the i cosines u and one of the j cosines w.

        Returns
        -------
        ndarray of complex128, shape (n, i, j, i, j)
        """
        along_u, along_w = self._line_products()
        return self._joined(along_u[:, :, None, :, None], along_w[:, None, :, None, :])

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
        """The same of all pairs of one of the i cosines u and one of the j cosines w.

        Parameters
        ----------
        snapshots : ndarray of complex, shape (n, *elements)

        Returns
        -------
        ndarray of complex, shape (n, i, j)
        """

    @abstractmethod
    def beams(self, snapshots: Complex) -> Complex:
        """Outputs of filters matched to one direction each, for many snapshots.

        Parameters
        ----------
        snapshots : ndarray of complex, shape (n, s, *elements)
            n the number of directions, which have no other axis.

        Returns
        -------
        ndarray of complex, shape (n, s)
        """

    @abstractmethod
    def synthesis(self, amplitude: Complex) -> Complex:
        """Sum of the plane waves.

        Parameters
        ----------
        amplitude : ndarray of complex, shape (n, k)

        Returns
        -------
        ndarray of complex, shape (n, *elements)
        """

    @abstractmethod
    def _joined(self, along_u: Complex, along_w: Complex) -> Complex:
        """Mean products over all elements from the products over each line."""

    def _filters(self, snapshots: Complex) -> tuple[Complex, Complex]:
        """Conjugate responses in the precision of snapshots."""
        a, b = (line.conj().astype(snapshots.dtype, copy=False) for line in (self.along_u, self.along_w))
        return a, b

    def _line_products(self) -> tuple[Complex, Complex]:
        a, b = self.along_u, self.along_w
        return a.conj() @ a.swapaxes(-1, -2), b.conj() @ b.swapaxes(-1, -2)


class _PlaneResponses(Responses):
    """On all P x Q elements, which are touched along one axis and then along the other."""

    def matched(self, snapshots: Complex) -> Complex:
        a, b = self._filters(snapshots)
        matched: Complex = np.sum((a @ snapshots) * b, axis=3)
        matched /= self.n_elements
        return matched

    def matched_intersections(self, snapshots: Complex) -> Complex:
        a, b = self._filters(snapshots)
        matched: Complex = a @ snapshots @ b.transpose(0, 2, 1)
        matched /= self.n_elements
        return matched

    def beams(self, snapshots: Complex) -> Complex:
        n, n_snapshots, n_p, n_q = snapshots.shape
        # Two products of large matrices with vectors, and none of as many small ones.
        a, b = self._filters(snapshots)
        columns = snapshots.reshape(n, n_snapshots * n_p, n_q) @ b[:, :, None]
        outputs = columns.reshape(n, n_snapshots, n_p) @ a[:, :, None]
        beams: Complex = outputs[:, :, 0] / self.n_elements
        return beams

    def synthesis(self, amplitude: Complex) -> Complex:
        waves: Complex = (self.along_u * amplitude[:, :, None]).transpose(0, 2, 1) @ self.along_w
        return waves

    def _joined(self, along_u: Complex, along_w: Complex) -> Complex:
        joined: Complex = along_u * along_w
        joined /= self.n_elements
        return joined


class _CrossResponses(Responses):
    """On one column, and on the rest of one row."""

    def matched(self, snapshots: Complex) -> Complex:
        outputs = np.concatenate(self._filters(snapshots), axis=-1) @ snapshots[..., None]
        matched: Complex = outputs[..., 0] / self.n_elements
        return matched

    def matched_intersections(self, snapshots: Complex) -> Complex:
        a, b = self._filters(snapshots)
        n_p = a.shape[-1]
        along_w = b @ snapshots[:, n_p:, None]
        return self._joined(a @ snapshots[:, :n_p, None], along_w.transpose(0, 2, 1))

    def beams(self, snapshots: Complex) -> Complex:
        filters: Complex = np.concatenate(self._filters(snapshots), axis=-1)
        outputs = snapshots @ filters[:, :, None]
        beams: Complex = outputs[:, :, 0] / self.n_elements
        return beams

    def synthesis(self, amplitude: Complex) -> Complex:
        both = np.concatenate([self.along_u, self.along_w], axis=-1)
        waves: Complex = (amplitude[:, None, :] @ both)[:, 0]
        return waves

    def _joined(self, along_u: Complex, along_w: Complex) -> Complex:
        joined: Complex = along_u + along_w
        joined /= self.n_elements
        return joined


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

    @property
    @abstractmethod
    def n_elements(self) -> int:
        """Elements that are read."""

    @property
    @abstractmethod
    def shape(self) -> tuple[int, ...]:
        """Axes of the elements in snapshots."""

    @abstractmethod
    def towards(self, u: Floats, w: Floats) -> Responses:
        """Responses to directions.

        Parameters
        ----------
        u, w : ndarray of float64
            Direction cosines: k a cell, shape (n, k), or of each of n beams,
            shape (n,). For intersections i cosines u and j cosines w a cell,
            shapes (n, i) and (n, j).

        Returns
        -------
        Responses
        """

    @abstractmethod
    def lines(self, snapshots: Complex) -> tuple[Complex, Complex]:
        """Read snapshots as lines of sensors along u, and as lines along w.

        Parameters
        ----------
        snapshots : ndarray of complex, shape (n, *elements)

        Returns
        -------
        along_u : ndarray of complex, shape (n, P, s)
            s lines each.
        along_w : ndarray of complex, shape (n, Q, t)
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

    @property
    def n_elements(self) -> int:
        """Elements P Q."""
        return self.n_p * self.n_q

    @property
    def shape(self) -> tuple[int, ...]:
        """(P, Q)."""
        return self.n_p, self.n_q

    def towards(self, u: Floats, w: Floats) -> Responses:
        """Responses of all columns and rows."""
        return _PlaneResponses(steering(self.n_p, u), steering(self.n_q, w), self.n_elements)

    def lines(self, snapshots: Complex) -> tuple[Complex, Complex]:
        """Columns and rows: Q lines along u, P along w."""
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

    @property
    def n_elements(self) -> int:
        """Elements P + Q - 1."""
        return self.n_p + self.n_q - 1

    @property
    def shape(self) -> tuple[int, ...]:
        """(P + Q - 1,)."""
        return (self.n_elements,)

    def towards(self, u: Floats, w: Floats) -> Responses:
        """Responses of the column and of the rest of the row."""
        return _CrossResponses(steering(self.n_p, u), steering(self.n_q, w)[..., 1:], self.n_elements)

    def lines(self, snapshots: Complex) -> tuple[Complex, Complex]:
        """The column and the row, which share the element (0, 0)."""
        row = np.concatenate([snapshots[:, :1], snapshots[:, self.n_p :]], axis=1)
        return snapshots[:, : self.n_p, None], row[:, :, None]
