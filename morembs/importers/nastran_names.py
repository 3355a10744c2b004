"""Which cards of Nastran bulk data are read, left out with a note, or kept for a program that has their elements."""

from __future__ import annotations

SYSTEMS = ("CORD1R", "CORD1C", "CORD1S", "CORD2R", "CORD2C", "CORD2S")
# Cards of one value between two components: the matrix, the card of their property or none.
SCALARS = {
    "CELAS1": ("K", "PELAS"), "CELAS2": ("K", ""), "CMASS1": ("M", "PMASS"), "CMASS2": ("M", ""),
    "CDAMP1": ("D", "PDAMP"), "CDAMP2": ("D", ""),
}  # fmt: skip
RIGID = ("RBE1", "RBE2", "RBE3", "RBAR", "RROD", "RTRPLT")
READ = (
    "PSOLID", "MAT1", "MAT9", "MAT11", *RIGID, "CONM1", "CONM2", "PARAM", "SET1", "GRDSET", "MPC", "MPCADD",
    "CBUSH", "PBUSH", *SCALARS, "PELAS", "PMASS", "PDAMP", *SYSTEMS,
)  # fmt: skip
# Shells and bars, their properties, and materials and defaults that only these have.
STRUCTURAL = (
    "CQUAD4", "CQUAD8", "CQUADR", "CTRIA3", "CTRIA6", "CTRIAR", "CSHEAR", "CROD", "CONROD", "CTUBE", "CBAR", "CBEAM",
)  # fmt: skip
PROPERTIES = (
    "PSHELL", "PCOMP", "PCOMPG", "PSHEAR", "PROD", "PTUBE", "PBAR", "PBARL", "PBEAM", "PBEAML", "PBCOMP", "MAT2",
    "MAT8", "BAROR", "BEAMOR",
)  # fmt: skip
RESTRAINTS = ("SPC", "SPC1", "SPCADD", "SPCD", "SUPORT", "SUPORT1")
# Materials that vary with temperature; the values of the material itself hold.
OF_TEMPERATURE = ("MATT1", "MATT9", "MATT11")
# Part of superelements within one file: all of it is one model.
SUPERELEMENTS = (
    "SESET", "SEELT", "SEEXCLD", "SEBSET", "SEBSET1", "SECSET", "SECSET1", "SEQSET", "SEQSET1", "SESUP", "SETREE",
)  # fmt: skip

_LOADS = """
    FORCE FORCE1 FORCE2 MOMENT MOMENT1 MOMENT2 PLOAD PLOAD1 PLOAD2 PLOAD3 PLOAD4 PLOADB3 PLOADE1 PLOADX1 SLOAD GRAV
    RFORCE RFORCE1 ACCEL ACCEL1 LOAD DLOAD LSEQ DAREA RLOAD1 RLOAD2 TLOAD1 TLOAD2 ACSRCE PRESAX MOMAX FORCEAX DEFORM
    DPHASE DELAY TABLED1 TABLED2 TABLED3 TABLED4 TABRND1 TABRNDG RANDPS RANDT1 UNBALNC NOLIN1 NOLIN2 NOLIN3 NOLIN4
    LOADCLID CLOAD BOLTFOR BOLTLD BOLTSEQ
    TEMP TEMPD TEMPP1 TEMPP2 TEMPP3 TEMPRB TEMPAX TEMPF TEMPG TEMPB3 TEMPBC SPCR SPCAX SPCD2 SPCOFF SPCOFF1 TIC TICD
"""
_SOLUTION = """
    EIGRL EIGR EIGB EIGC EIGP EIGRLX FREQ FREQ1 FREQ2 FREQ3 FREQ4 FREQ5 TSTEP TSTEP1 TSTEPNL NLPARM NLPCI NLSTEP NLCNTL
    NLCNTL2 NLCNTLG TABDMP1 ASET ASET1 QSET QSET1 BSET BSET1 BNDFIX BNDFIX1 BNDFREE BNDFREE1 CSET CSET1 OMIT OMIT1 USET
    USET1 DYNRED SEQGP SEQEP SPOINT EPOINT RSPINR RSPINT ROTORG ROTORD ROTORSE CAMPBLL MODTRAK MDLPRM DEBUG PARTN RGYRO
"""
_OUTPUT = """
    ECHOON ECHOOFF SET2 SET3 PLOTEL PLOTEL3 PLOTEL4 CBARAO SNORM USRDAT RESPONSE OUTPUT ENDDATA ACCMETR MONPNT1 MONPNT2
    MONPNT3 MONDSP1 MONSUM MONSUM1 TOMVAR UXVEC STREAM SWLDPRM MODAL MARPRN GEOMCHECK BNDGRID FLSYM
"""
_MATERIALS = """
    MAT3 MAT4 MAT5 MAT10 MATT2 MATT3 MATT4 MATT5 MATT8 MATS1 MATF MATHE TABLES1 TABLEST TABLEM1 TABLEM2 TABLEM3 TABLEM4
    TABLE3D TABLEH1 TABLEHT CREEP
    PBEND PBMSECT PBRSECT PBEAM3 PGAP PBUSH1D PBUSHT PELAST PDAMPT PDAMP5 PVISC PWELD PFAST PLPLANE PPLANE PRAC2D PRAC3D
"""
_AERODYNAMICS = """
    AERO AEROS AEFACT AELIST AELINK AEPARM AESTAT AESURF AESURFS AEFORCE AEPRESS AESCALE AECOMP AECOMPL AEDW AEGRID
    CAERO1 CAERO2 CAERO3 CAERO4 CAERO5 PAERO1 PAERO2 PAERO3 PAERO4 PAERO5 SPLINE1 SPLINE2 SPLINE3 SPLINE4 SPLINE5
    SPLINE6 SPLINE7 FLUTTER FLFACT MKAERO1 MKAERO2 TRIM TRIM2 GUST DIVERG CSSCHD
"""
_OPTIMISATION = """
    DESVAR DDVAL DLINK DRESP1 DRESP2 DRESP3 DVPREL1 DVPREL2 DVMREL1 DVMREL2 DVCREL1 DVCREL2 DVGRID DVSHAP DVBSHAP
    DVPSURF DCONSTR DCONADD DEQATN DOPTPRM DSCREEN DTABLE DSCONS DVSET DVAR DVPREL BEADVAR TOPVAR TOPOPT DESGLB DTPG
    DOBJ
"""
_HEAT = """
    CONV CONVM PCONV PCONVM CHBDYE CHBDYG CHBDYP PHBDY QBDY1 QBDY2 QBDY3 QHBDY QVECT QVOL RADBC RADCAV RADLST RADM RADMT
    RADMTX RADSET VIEW VIEW3D BDYOR TEMPN1
"""
# Regions of surfaces; without contact between them they do nothing.
_REGIONS = "BSURF BSURFS BCPROP BCPROPS BCBODY BCPARM BCPARA BCRPARA"
_DATA = "DMI DMIJ DMIJI DMIK DTI DMIAX SUPAX CSSHL CYSUP CYAX"
_WORDS = (_LOADS, _SOLUTION, _OUTPUT, _MATERIALS, _AERODYNAMICS, _OPTIMISATION, _HEAT, _REGIONS, _DATA)
NOTED = frozenset((*RESTRAINTS, *SUPERELEMENTS, *PROPERTIES, *" ".join(_WORDS).split()))

# Why a card cannot be carried, and what to do besides leaving it out; others are named alone.
REASONS = {
    **dict.fromkeys(STRUCTURAL, "shells and bars, which are not assembled here"),
    **dict.fromkeys(("CBEND", "CBEAM3", "CRAC2D", "CRAC3D"), "elements that are not assembled here"),
    **dict.fromkeys(
        ("BCTSET", "BCTADD", "BCTPARM", "BCONP", "BLSEG", "BFRIC", "BCTABLE", "BCTABL1", "BCONECT", "BCONPRG",
         "BCONPRP", "CGAP", "BGSET", "BGADD", "BGPARM", "TIE", "CONTACT"),
        "contact or glue between surfaces",
    ),
    **dict.fromkeys(
        ("CSUPER", "CSUPEXT", "SEBULK", "SELABEL", "SELOC", "SEMPLN", "SECONCT", "SEDRSP2", "EXTRN", "BEGIN", "RELEASE",
         "SEDLINK"),
        "superelements of their own",
    ),
    **dict.fromkeys(("DMIG", "DMIGROT", "TF", "GENEL"), "matrices added to those of the elements"),
    **dict.fromkeys(("PLSOLID", "MATHP", "MATHED", "MATG", "MATUSR", "MATVE"), "nonlinear materials"),
    **dict.fromkeys(("PCOMPS", "PCOMPLS"), "layered solids"),
    **dict.fromkeys(("CPYRAM", "CPYRA"), "pyramids"),
    **dict.fromkeys(
        ("CELAS3", "CELAS4", "CMASS3", "CMASS4", "CDAMP3", "CDAMP4"),
        "springs, masses and dampers between scalar points",
    ),
    **dict.fromkeys(("NSM", "NSM1", "NSMADD", "NSML", "NSML1"), "mass that is not of the elements' materials"),
    **dict.fromkeys(("CFAST", "CWELD", "CSEAM", "CINTC"), "connectors"),
    **dict.fromkeys(("CVISC", "CBUSH1D", "CBUSH2D", "CDAMP5"), "dampers of other kinds"),
    **dict.fromkeys(("CHACAB", "CHACBR", "CAABSF", "CACINF3", "CACINF4"), "acoustic elements"),
    **dict.fromkeys(("CTRIAX6", "CTRAX3", "CTRAX6", "CQUADX4", "CQUADX8", "CTRIAX", "CQUADX"), "axisymmetric elements"),
    **dict.fromkeys(("CYJOIN", "CYSYM"), "cyclic symmetry"),
    **dict.fromkeys(("RSPLINE", "RSSCON", "RJOINT", "RBE3D", "RBJOINT"), "rigid elements of other kinds"),
}  # fmt: skip
