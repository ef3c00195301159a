"""Volumes of breasts that were segmented in label maps: DICOM segmentations, NRRD, NIfTI."""
