"""What disturbs the receiver: emitters, their placement at exact SIR and overlap, and the stream a jammer sends."""
