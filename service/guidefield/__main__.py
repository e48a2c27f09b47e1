"""`python -m guidefield` is the command line."""

from guidefield.cli import main

if __name__ == "__main__":
    main()
