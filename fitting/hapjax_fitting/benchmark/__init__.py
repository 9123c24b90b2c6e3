"""Measurements of the fit itself: how near it comes to what can be known, and how long it takes."""
