"""A method in a separate package. It infers an intent from the ends of demonstrations, and plans to reach it."""
