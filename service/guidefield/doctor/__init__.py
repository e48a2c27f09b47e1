"""An examination of this machine: faults that guidefield suffers from, each with advice."""
