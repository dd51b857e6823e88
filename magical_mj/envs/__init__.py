"""The doors to the engine: Gymnasium and dm_env."""

import gymnasium  # noqa: F401  (first of all, since it makes `magical_mj` import our modules: see there)
