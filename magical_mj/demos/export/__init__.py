"""Exports of demonstrations to other formats."""
