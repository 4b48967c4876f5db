"""Two asteroids that attract each other: a Didymos-like binary, with end states known to many digits."""
