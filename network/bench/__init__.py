"""Benchmarks; each returns one object of figures and conditions."""
