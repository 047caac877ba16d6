"""How a controller moves: programs, profiles, driven and interrupted motion."""
