"""The page in the browser: the stand, the path and what the sensor sees; extra `viewer`, imported by its verb alone."""
