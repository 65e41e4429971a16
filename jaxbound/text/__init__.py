"""Text that people read: names, numbers and objects in sentences, safe in a terminal, a page and a
spreadsheet.
"""
