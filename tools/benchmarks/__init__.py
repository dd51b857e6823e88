"""How fast the environments are beside MuJoCo alone, which does the same simulation and draws the same pictures."""
