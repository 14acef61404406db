"""The 2014 report reproduced on one page: figures and tables of our runs, print and ours."""
