"""Benchmarks: the speed of the environments compared with MuJoCo alone for the same simulation and pictures."""
