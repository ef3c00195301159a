"""Volumes of segmented breasts in label maps: DICOM segmentations, NRRD, NIfTI."""
