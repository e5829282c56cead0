"""Shape sensing of soft continuum robots: three papers, regenerated, compared, improved."""
