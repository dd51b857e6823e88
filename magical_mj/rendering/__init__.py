"""Pictures of the world: the OpenGL backend, the canvas that all environments share, and drawing."""
