"""What a feature looks like, as numbers from which its noise can be predicted; one file a predictor."""
