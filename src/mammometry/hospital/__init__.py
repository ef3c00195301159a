"""A session's results for other systems: DICOM, FHIR, REDCap, tables."""
