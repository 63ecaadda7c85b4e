"""What the paper reports (Zheng, Liu, Guo and Yang, sections V-A and V-B), to set beside what is measured here."""

TABLE = {  # Table I: AR, PE, RES (the paper: SR), SD, RNG (the paper: R)
    "12B": (0.0006, -0.29, 0.309, 1.0, 1.960),
    "16B": (0.0027, -0.253, 0.469, 0.732, 1.401),
    "16I": (0.0035, 0.242, 0.320, 0.676, 1.2282),
    "16O": (0.00475, 0.173, 0.275, 0.573, 0.917),
}
LOCALISATION = {"16I": 13.01e-3, "16O": 10.23e-3}  # metres, mean over 81 positions (Fig. 7)
RATIO = LOCALISATION["16I"] / LOCALISATION["16O"]
DISCRIMINATION = {"16I": 17e-3, "16O": 12e-3}  # metres, smallest distance of two contacts told apart (Fig. 8)

SAYS = {
    "fig3": "The proposed method gives the best image of a single touch. Four more electrodes on the rim help, but "
    "mainly near the rim; electrodes inside the sheet help markedly, most of all in the centre.",
    "fig4": "Images of several touches by the proposed method are correct, clearer, and contain fewer artefacts.",
    "fig5": "In sections through the touch the proposed method reaches the largest value, and its width follows the "
    "pressure profile.",
    "table1": "For the touch in the upper left, the proposed method has the highest AR and the smallest PE; SD and RNG "
    "fall from each method to the next.",
    "fig6": "With adjacent drive the image has relatively large artefacts and another shape than the contact; with "
    "adaptive drive there are fewer artefacts and the shape of the object is reflected.",
    "fig7": "Over 81 places the average error is 1.301 cm with adjacent and 1.023 cm with adaptive drive (1.27 times "
    "less).",
    "fig8": "Two weights of 100 g, 60 mm apart and then closer by 5 mm each time: adjacent drive cannot "
    "distinguish them below 17 mm, adaptive drive can above 12 mm.",
    "sweep": "The paper gives no noise level and no regularisation parameter.",
    "assumptions": "A card that samples all electrodes in parallel, a constant voltage source, a linear image with a "
    "Laplacian prior; Table I improves from each method to the next, Fig. 7 by 1.27 times, Fig. 8 from 17 to 12 mm.",
}  # in our words
TESTED_ON = dict.fromkeys(("fig3", "fig4", "fig5", "table1"), "discs")  # data made as in the paper
TESTED_ON |= dict.fromkeys(("fig6", "fig7", "fig8"), "pressed")
