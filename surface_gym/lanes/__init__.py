"""What a lane is: one parcel on one surface, as rows of arrays that compiled code reads."""
