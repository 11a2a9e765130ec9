"""The concealed study: cases whose truth is sealed are drawn, diagnosed without looking, and scored."""
