"""A concealed study: which cases it has, how they are drawn and sealed."""
