/* Everything that differs between Embree 3 and 4, behind one interface. */
#pragma once

#include <stddef.h>

#ifdef WHIT_EMBREE_4
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

/* What accompanies a trace call: Embree 3's intersection context, or Embree 4's two argument structures. */
struct WhitQuery;

/* RTC_VERSION of the headers. */
unsigned int whitHeaderVersion(void);

/* Bytes of a WhitQuery; it needs the alignment of a pointer. */
size_t whitQuerySize(void);

/* Prepares a query; `coherent` is nonzero for rays that run side by side. */
void whitInitQuery(struct WhitQuery *query, int coherent);

void whitIntersect1(RTCScene scene, struct WhitQuery *query, struct RTCRayHit *rayhit);
void whitIntersect4(const int *valid, RTCScene scene, struct WhitQuery *query, struct RTCRayHit4 *rayhit);
void whitIntersect8(const int *valid, RTCScene scene, struct WhitQuery *query, struct RTCRayHit8 *rayhit);
void whitIntersect16(const int *valid, RTCScene scene, struct WhitQuery *query, struct RTCRayHit16 *rayhit);

void whitOccluded1(RTCScene scene, struct WhitQuery *query, struct RTCRay *ray);
void whitOccluded4(const int *valid, RTCScene scene, struct WhitQuery *query, struct RTCRay4 *ray);
void whitOccluded8(const int *valid, RTCScene scene, struct WhitQuery *query, struct RTCRay8 *ray);
void whitOccluded16(const int *valid, RTCScene scene, struct WhitQuery *query, struct RTCRay16 *ray);

/* Offset in bytes of the instance-within-instance-array lane of a 16-wide hit, or 0 where there is none. */
size_t whitInstPrimOffset16(void);
