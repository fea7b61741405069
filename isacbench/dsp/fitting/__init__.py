"""Scatterers fitted to a range-Doppler map: selected, refined and told apart together."""
