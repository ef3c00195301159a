"""DICOM: objects of a session, archives, worklists."""
