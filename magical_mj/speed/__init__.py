"""How fast the environments are, beside what MuJoCo itself takes for the same simulation and the same pictures."""
