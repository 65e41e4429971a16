"""Pages: what a test found as one self-contained HTML file that a plant engineer can read, mail and print."""
