"""The documentation: one page a subject, in Markdown; `guidefield docs` and the website list those of `CHAPTERS`.

`CHAPTERS` is in `guidefield/cli/documentation.py`. Tables of `wire.md`, and `wire.schema.json`, are made from the code
by `tools/wire_page`.
"""
