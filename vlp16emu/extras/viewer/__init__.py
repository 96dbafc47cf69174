"""Pages in the browser, and pictures: the stand, the path and what the sensor sees.

Pages need the extra `viewer`, pictures the extra `picture`.
"""
