"""The environments for Gymnasium and dm_env."""
