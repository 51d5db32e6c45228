"""Reference pages from the program's own tables, as Markdown. Each module makes one
kind of page.
"""
