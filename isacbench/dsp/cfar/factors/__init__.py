"""Exact threshold factors: α such that P(power > α · noise estimate) = P_fa.

The noise is homogeneous complex Gaussian of unknown power, so the power of a
cell, averaged over M looks, is gamma distributed with shape M (exponential for
one look). Every factor multiplies the detector's *own* noise estimate, a mean
or an order statistic, whatever bias that estimate has.

| noise estimate | factor | found by |
|---|---|---|
| mean | `ca_factor` | closed form: a quantile of the F distribution |
| greater, smaller of two means | `goca_factor`, `soca_factor` | root of a finite sum of beta functions |
| order statistics, averaged | `osca_factor` | root; one-dimensional quadrature |
| trimmed mean | `tm_factor` | root of a product; quadrature with many looks |
"""

from __future__ import annotations

from isacbench.dsp.cfar.factors.mean_factors import (
    ca_factor,
    ca_rate,
    goca_factor,
    paper_factor,
    soca_factor,
)
from isacbench.dsp.cfar.factors.order_factors import osca_factor, osca_rate
from isacbench.dsp.cfar.factors.rate_roots import check_looks, check_pfa
from isacbench.dsp.cfar.factors.trimmed_factors import tm_factor

__all__ = [
    "ca_factor",
    "ca_rate",
    "check_looks",
    "check_pfa",
    "goca_factor",
    "osca_factor",
    "osca_rate",
    "paper_factor",
    "soca_factor",
    "tm_factor",
]
