"""Membership of a point in the image of a box: strips, their circuits, a search, polynomials in parameters.
strips, their circuits, a search, polynomials in parameters.
"""
