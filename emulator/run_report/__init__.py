"""`lidaremu report`: what a recording tells, added up in one pass and written as one page."""
