"""Is a point in the image of a box? Strips, their circuits, the search where these are too many, polynomials
in parameters.
"""
