"""From a scene to MJCF: what each thing looks like, how it collides, and what drives it. Knows no tasks."""
