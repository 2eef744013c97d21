"""Coverage of an operational design domain (ODD) by the runs of campaigns."""
