"""Where sensors are best placed."""
