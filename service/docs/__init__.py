"""The documentation: one page a subject, in Markdown; `guidefield docs` lists them."""
