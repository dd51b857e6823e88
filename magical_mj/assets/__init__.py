"""MJCF models of scenes: the look of each thing, its collision geometry and its actuators. Independent of tasks."""
