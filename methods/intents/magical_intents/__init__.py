"""Policies in a separate package. They learn what to do from demonstrations at test time."""
