"""The doors to the engine: Gymnasium and dm_env."""
