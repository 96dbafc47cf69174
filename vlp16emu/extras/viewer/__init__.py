"""The page in the browser: the stand, the path and what the sensor sees.

It needs the extra `viewer`, and its verb alone imports it.
"""
