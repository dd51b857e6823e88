"""Rendering: the choice of an OpenGL backend, the OpenGL context that all environments share, and drawing."""
