"""Raw carriers as rows of Wd + j Wq."""
