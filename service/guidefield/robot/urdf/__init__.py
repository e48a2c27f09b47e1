"""URDFs and SRDFs, read strictly: each fault is named by its line before Pinocchio can misread it."""
