"""Benchmarks: each returns one object of figures and the conditions they were measured under."""
