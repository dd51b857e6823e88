"""Speed of the environments, compared with MuJoCo alone doing the same simulation and drawing the same pictures."""
