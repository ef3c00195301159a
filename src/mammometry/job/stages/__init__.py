"""The method, stage by stage: each product is a function of the products that it is computed from."""
