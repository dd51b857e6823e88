"""The environments in the APIs of Gymnasium and dm_env."""
