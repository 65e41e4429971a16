"""Pages: what was found as one self-contained HTML file that a plant engineer can read, mail and print.

One file a page and its template of the same name: the words are there, the values come from here.
"""
