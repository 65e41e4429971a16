"""Pages: what was found as one self-contained HTML file that a plant engineer can read, mail and print.

One file a page, with its template beside it; texts and words are in the template, values come from here.
"""
