"""URDFs and SRDFs, read strictly."""
