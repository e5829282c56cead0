"""Commands on a robot file that read recordings or a board."""
