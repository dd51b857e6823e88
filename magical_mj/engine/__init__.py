"""The engine: one world of MuJoCo with its scene, score and states."""
