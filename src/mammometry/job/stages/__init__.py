"""The method, stage by stage: each product is a function whose parameters are what it is made from."""
