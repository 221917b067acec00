"""Benchmarks of relative pose on image pairs with a known answer."""
