/* Everything that differs between Embree 3.13 and Embree 4, behind calls that read the same for both.
 *
 * What is the same in both (devices, scenes, geometries, buffers) is called directly. */
#pragma once

#if EMBREE_SYS_API == 4
#include <embree4/rtcore.h>
typedef struct RTCRayQueryContext EmbreeContext;
#elif EMBREE_SYS_API == 3
#include <embree3/rtcore.h>
typedef struct RTCIntersectContext EmbreeContext;
#else
#error "EMBREE_SYS_API must be 3 or 4"
#endif

/* What accompanies a query: Embree 3 keeps the flags in the context, Embree 4 in one structure of arguments a call.
 *
 * The context comes first, so that a callback may turn the context it is handed back into the query, and trace another
 * scene with it. A query may be moved, and used for any number of calls by one thread at a time. */
struct EmbreeQuery {
  EmbreeContext context;
#if EMBREE_SYS_API == 4
  struct RTCIntersectArguments intersect;
  struct RTCOccludedArguments occluded;
#endif
};

/* Prepares `query` without a filter; `coherent` is 1 where the rays of a packet run side by side, else 0. */
void embree_query_init(struct EmbreeQuery *query, int coherent);

/* Nearest hit of 1, 4, 8 or 16 rays. `valid` holds -1 for lanes to trace and 0 for the others, aligned as the rays. */
void embree_intersect1(RTCScene scene, struct EmbreeQuery *query, struct RTCRayHit *rays);
void embree_intersect4(const int *valid, RTCScene scene, struct EmbreeQuery *query, struct RTCRayHit4 *rays);
void embree_intersect8(const int *valid, RTCScene scene, struct EmbreeQuery *query, struct RTCRayHit8 *rays);
void embree_intersect16(const int *valid, RTCScene scene, struct EmbreeQuery *query, struct RTCRayHit16 *rays);

/* Any hit of 1, 4, 8 or 16 rays: `tfar` of a blocked ray becomes negative infinity. */
void embree_occluded1(RTCScene scene, struct EmbreeQuery *query, struct RTCRay *rays);
void embree_occluded4(const int *valid, RTCScene scene, struct EmbreeQuery *query, struct RTCRay4 *rays);
void embree_occluded8(const int *valid, RTCScene scene, struct EmbreeQuery *query, struct RTCRay8 *rays);
void embree_occluded16(const int *valid, RTCScene scene, struct EmbreeQuery *query, struct RTCRay16 *rays);

/* Tells Embree which lanes a user geometry's callback has hit: Embree 4 wants -1 or 0 in `valid`, Embree 3 reads the hits
 * themselves and `valid` is input only. `hit` holds `count` values, -1 for a hit and 0 for none. */
void embree_report_lanes(int *valid, const int *hit, unsigned int count);
